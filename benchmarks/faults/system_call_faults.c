/* Preloaded into a process: makes the n-th call of one function of the C library fail with a given errno, shifts the clock of the day, and
 * records what is written below a folder, so that a power cut can be computed from it.
 *
 *   gcc -O2 -shared -fPIC -o system_call_faults.so system_call_faults.c -ldl
 *
 * Nothing happens until fault_arm, fault_clock or fault_record is called (by ctypes), or FAULT_ARM=call:n:errno stands in the environment
 * of a process whose command line contains FAULT_ROLE, or FAULT_RECORD=folder|file in that of a program that another one starts. Calls that a library makes without the C library (its own mmap inside malloc, futex)
 * are not seen.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { C_OPEN, C_READ, C_WRITE, C_FSYNC, C_RENAME, C_UNLINK, C_MKDIR, C_STAT, C_TRUNCATE, C_MMAP, C_ALLOC, C_SOCKET, C_CONNECT, C_BIND, C_SEND,
       C_RECV, C_POLL, C_PIPE, CALLS };
static const char *const names[CALLS] = {"open", "read", "write", "fsync", "rename", "unlink", "mkdir", "stat", "ftruncate", "mmap", "alloc",
                                         "socket", "connect", "bind", "send", "recv", "poll", "pipe"};
#define LARGE (1u << 20)

static atomic_long count[CALLS];
static atomic_int armed_call = -1, armed_errno, struck, counting;
static atomic_long armed_n, clock_shift_s;
static int log_fd = -1;
static char below_folder[4096];
static size_t below_length;
static char log_folder[4096];
static size_t log_length;
static atomic_int log_lock;

/* 1 where this call is the one that must fail; errno is set then. */
static int fails(int call) {
    if (!atomic_load_explicit(&counting, memory_order_relaxed)) return 0;
    long n = atomic_fetch_add(&count[call], 1);
    if (call != atomic_load(&armed_call) || n != atomic_load(&armed_n)) return 0;
    atomic_store(&struck, 1);
    errno = atomic_load(&armed_errno);
    return 1;
}

int fault_arm(const char *call, long n, int error) {
    for (int i = 0; i < CALLS; i++) atomic_store(&count[i], 0);
    atomic_store(&struck, 0);
    atomic_store(&armed_call, -1);
    for (int i = 0; i < CALLS; i++)
        if (!strcmp(call, names[i])) atomic_store(&armed_call, i);
    atomic_store(&armed_n, n);
    atomic_store(&armed_errno, error);
    atomic_store(&counting, 1);
    return atomic_load(&armed_call);
}
/* From now on only writes below this folder count and fail, as on a disk of its own. */
void fault_below(const char *folder) {
    strncpy(below_folder, folder, sizeof below_folder - 1);
    below_length = strlen(below_folder);
}
static int is_below(int fd) {
    char link[64], path[4096];
    if (!below_length) return 1;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    return n > 0 && (size_t)n > below_length && !strncmp(path, below_folder, below_length);
}
/* Every call from the n-th on fails: a disk that is full stays full. */
static int fails_for_good(int call, int fd) {
    if (!atomic_load_explicit(&counting, memory_order_relaxed) || !is_below(fd)) return 0;
    if (!below_length) return fails(call);
    long n = atomic_fetch_add(&count[call], 1);
    if (call != atomic_load(&armed_call) || n < atomic_load(&armed_n)) return 0;
    atomic_store(&struck, 1);
    errno = atomic_load(&armed_errno);
    return 1;
}
int fault_disarm(void) { atomic_store(&counting, 0); return atomic_load(&struck); }
long fault_count(int call) { return atomic_load(&count[call]); }
const char *fault_name(int call) { return call < CALLS ? names[call] : ""; }
void fault_clock(long seconds) { atomic_store(&clock_shift_s, seconds); }

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)

static ssize_t raw_write(int fd, const void *data, size_t size) {
    REAL(ssize_t, write, int, const void *, size_t);
    return real(fd, data, size);
}

/* Record: kind, name (relative), second name or '', offset, data. */
static void record(char kind, const char *path, const char *other, int64_t at, const void *data, uint64_t size) {
    if (log_fd < 0 || strncmp(path, log_folder, log_length)) return;
    int kept = errno;
    path += log_length;
    if (other && !strncmp(other, log_folder, log_length)) other += log_length;
    while (atomic_exchange(&log_lock, 1)) ;
    uint32_t lengths[2] = {(uint32_t)strlen(path), other ? (uint32_t)strlen(other) : 0};
    struct timespec now = {0, 0};
    clock_gettime(CLOCK_MONOTONIC, &now);
    double time_s = now.tv_sec + 1e-9 * now.tv_nsec;
    raw_write(log_fd, &kind, 1);
    raw_write(log_fd, &time_s, 8);
    raw_write(log_fd, lengths, 8);
    raw_write(log_fd, path, lengths[0]);
    if (other) raw_write(log_fd, other, lengths[1]);
    raw_write(log_fd, &at, 8);
    raw_write(log_fd, &size, 8);
    for (uint64_t done = 0; done < size;) {
        ssize_t more = raw_write(log_fd, (const char *)data + done, size - done);
        if (more <= 0) break;
        done += more;
    }
    atomic_store(&log_lock, 0);
    errno = kept;
}
static int path_of(int fd, char *path) {
    char link[64];
    if (log_fd < 0 || fd == log_fd) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, 4095);
    if (n <= 0) return 0;
    path[n] = 0;
    return 1;
}
int fault_record(const char *folder, const char *file) {
    REAL(int, open64, const char *, int, ...);
    int fd = real(file, O_WRONLY | O_CREAT | O_APPEND, 0600);
    strncpy(log_folder, folder, sizeof log_folder - 1);
    log_length = strlen(log_folder);
    log_fd = fd;
    return fd;
}

__attribute__((constructor)) static void from_environment(void) {
    const char *what = getenv("FAULT_ARM"), *role = getenv("FAULT_ROLE"), *log = getenv("FAULT_RECORD");
    char place[4096] = "";
    if (log && strchr(log, '|')) { /* folder|file */
        strncpy(place, log, sizeof place - 1);
        *strchr(place, '|') = 0;
        fault_record(place, strchr(log, '|') + 1);
    }
    if (!what || !role) return;
    char line[8192] = "", call[32];
    long n;
    int error, fd = open("/proc/self/cmdline", O_RDONLY);
    ssize_t size = fd < 0 ? 0 : read(fd, line, sizeof line - 1);
    if (fd >= 0) close(fd);
    for (ssize_t i = 0; i < size; i++)
        if (!line[i]) line[i] = ' ';
    if (strstr(line, role) && sscanf(what, "%31[^:]:%ld:%d", call, &n, &error) == 3) fault_arm(call, n, error);
}

static void opened(const char *path, int flags, int fd) {
    char full[4096];
    if (fd >= 0 && log_fd >= 0 && (flags & (O_CREAT | O_TRUNC)) && path_of(fd, full)) record(flags & O_TRUNC ? 't' : 'c', full, NULL, 0, NULL, 0);
    (void)path;
}
#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(int, name, const char *, int, ...); \
        mode_t mode = 0; \
        if (flags & (O_CREAT | O_TMPFILE)) { va_list more; va_start(more, flags); mode = va_arg(more, mode_t); va_end(more); } \
        if (fails(C_OPEN)) return -1; \
        int fd = real(path, flags, mode); \
        opened(path, flags, fd); \
        return fd; \
    }
OPEN(open)
OPEN(open64)
#define OPENAT(name) \
    int name(int folder, const char *path, int flags, ...) { \
        REAL(int, name, int, const char *, int, ...); \
        mode_t mode = 0; \
        if (flags & (O_CREAT | O_TMPFILE)) { va_list more; va_start(more, flags); mode = va_arg(more, mode_t); va_end(more); } \
        if (fails(C_OPEN)) return -1; \
        int fd = real(folder, path, flags, mode); \
        opened(path, flags, fd); \
        return fd; \
    }
OPENAT(openat)
OPENAT(openat64)

static void written(int fd, const void *data, ssize_t size, int64_t at) {
    char path[4096];
    if (log_fd < 0 || size <= 0 || fd <= 2 || !path_of(fd, path)) return;
    if (at < 0) at = lseek(fd, 0, SEEK_CUR) - size;
    if (at >= 0) record('w', path, NULL, at, data, size);
}
ssize_t read(int fd, void *data, size_t size) {
    REAL(ssize_t, read, int, void *, size_t);
    return fails(C_READ) ? -1 : real(fd, data, size);
}
ssize_t write(int fd, const void *data, size_t size) {
    if (fails_for_good(C_WRITE, fd)) return -1;
    ssize_t done = raw_write(fd, data, size);
    written(fd, data, done, -1);
    return done;
}
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    REAL(ssize_t, pwrite64, int, const void *, size_t, off64_t);
    if (fails_for_good(C_WRITE, fd)) return -1;
    ssize_t done = real(fd, data, size, at);
    written(fd, data, done, at);
    return done;
}
ssize_t writev(int fd, const struct iovec *parts, int n) {
    REAL(ssize_t, writev, int, const struct iovec *, int);
    if (fails_for_good(C_WRITE, fd)) return -1;
    if (log_fd >= 0 && n > 0) { /* one part at a time, so that each can be recorded; a short write is allowed */
        for (int i = 0; i < n; i++)
            if (parts[i].iov_len) {
                ssize_t done = raw_write(fd, parts[i].iov_base, parts[i].iov_len);
                written(fd, parts[i].iov_base, done, -1);
                return done;
            }
    }
    return real(fd, parts, n);
}
#define SYNC(name) \
    int name(int fd) { \
        REAL(int, name, int); \
        char path[4096]; \
        if (fails(C_FSYNC)) return -1; \
        int done = real(fd); \
        if (!done && path_of(fd, path)) record('s', path, NULL, 0, NULL, 0); \
        return done; \
    }
SYNC(fsync)
SYNC(fdatasync)
static void renamed(const char *old, const char *new) {
    if (log_fd >= 0) record('r', old, new, 0, NULL, 0);
}
int rename(const char *old, const char *new) {
    REAL(int, rename, const char *, const char *);
    if (fails(C_RENAME)) return -1;
    int done = real(old, new);
    if (!done) renamed(old, new);
    return done;
}
int renameat(int a, const char *old, int b, const char *new) {
    REAL(int, renameat, int, const char *, int, const char *);
    if (fails(C_RENAME)) return -1;
    int done = real(a, old, b, new);
    if (!done) renamed(old, new);
    return done;
}
int unlink(const char *path) {
    REAL(int, unlink, const char *);
    if (fails(C_UNLINK)) return -1;
    int done = real(path);
    if (!done) record('u', path, NULL, 0, NULL, 0);
    return done;
}
int mkdir(const char *path, mode_t mode) {
    REAL(int, mkdir, const char *, mode_t);
    return fails(C_MKDIR) ? -1 : real(path, mode);
}
int stat64(const char *path, struct stat64 *found) {
    REAL(int, stat64, const char *, struct stat64 *);
    return fails(C_STAT) ? -1 : real(path, found);
}
int stat(const char *path, struct stat *found) {
    REAL(int, stat, const char *, struct stat *);
    return fails(C_STAT) ? -1 : real(path, found);
}
int fstat64(int fd, struct stat64 *found) {
    REAL(int, fstat64, int, struct stat64 *);
    return fails(C_STAT) ? -1 : real(fd, found);
}
int ftruncate64(int fd, off64_t size) {
    REAL(int, ftruncate64, int, off64_t);
    return fails(C_TRUNCATE) ? -1 : real(fd, size);
}
void *mmap64(void *at, size_t size, int prot, int flags, int fd, off64_t offset) {
    REAL(void *, mmap64, void *, size_t, int, int, int, off64_t);
    return fails(C_MMAP) ? MAP_FAILED : real(at, size, prot, flags, fd, offset);
}
void *mmap(void *at, size_t size, int prot, int flags, int fd, off_t offset) {
    REAL(void *, mmap, void *, size_t, int, int, int, off_t);
    return fails(C_MMAP) ? MAP_FAILED : real(at, size, prot, flags, fd, offset);
}

extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);
void *malloc(size_t size) { return size > LARGE && fails(C_ALLOC) ? NULL : __libc_malloc(size); }
void *calloc(size_t n, size_t size) { return n * size > LARGE && fails(C_ALLOC) ? NULL : __libc_calloc(n, size); }
void *realloc(void *old, size_t size) { return size > LARGE && fails(C_ALLOC) ? NULL : __libc_realloc(old, size); }
void *aligned_alloc(size_t to, size_t size) { return size > LARGE && fails(C_ALLOC) ? NULL : __libc_memalign(to, size); }
int posix_memalign(void **found, size_t to, size_t size) {
    if (size > LARGE && fails(C_ALLOC)) return ENOMEM;
    *found = __libc_memalign(to, size);
    return *found ? 0 : ENOMEM;
}

int socket(int domain, int type, int protocol) {
    REAL(int, socket, int, int, int);
    return fails(C_SOCKET) ? -1 : real(domain, type, protocol);
}
int connect(int fd, const struct sockaddr *to, socklen_t size) {
    REAL(int, connect, int, const struct sockaddr *, socklen_t);
    return fails(C_CONNECT) ? -1 : real(fd, to, size);
}
int bind(int fd, const struct sockaddr *to, socklen_t size) {
    REAL(int, bind, int, const struct sockaddr *, socklen_t);
    return fails(C_BIND) ? -1 : real(fd, to, size);
}
ssize_t send(int fd, const void *data, size_t size, int flags) {
    REAL(ssize_t, send, int, const void *, size_t, int);
    return fails(C_SEND) ? -1 : real(fd, data, size, flags);
}
ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length) {
    REAL(ssize_t, sendto, int, const void *, size_t, int, const struct sockaddr *, socklen_t);
    return fails(C_SEND) ? -1 : real(fd, data, size, flags, to, length);
}
ssize_t recv(int fd, void *data, size_t size, int flags) {
    REAL(ssize_t, recv, int, void *, size_t, int);
    return fails(C_RECV) ? -1 : real(fd, data, size, flags);
}
ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length) {
    REAL(ssize_t, recvfrom, int, void *, size_t, int, struct sockaddr *, socklen_t *);
    return fails(C_RECV) ? -1 : real(fd, data, size, flags, from, length);
}
int poll(struct pollfd *fds, nfds_t n, int timeout) {
    REAL(int, poll, struct pollfd *, nfds_t, int);
    return fails(C_POLL) ? -1 : real(fds, n, timeout);
}
int select(int n, fd_set *r, fd_set *w, fd_set *e, struct timeval *timeout) {
    REAL(int, select, int, fd_set *, fd_set *, fd_set *, struct timeval *);
    return fails(C_POLL) ? -1 : real(n, r, w, e, timeout);
}
int pipe2(int fds[2], int flags) {
    REAL(int, pipe2, int *, int);
    return fails(C_PIPE) ? -1 : real(fds, flags);
}

int clock_gettime(clockid_t id, struct timespec *now) {
    REAL(int, clock_gettime, clockid_t, struct timespec *);
    int done = real(id, now);
    if (!done && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE)) now->tv_sec += atomic_load(&clock_shift_s);
    return done;
}
