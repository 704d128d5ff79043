/* A controller by the clock for benchmarks/rsi.py latency: one RSI telegram every 4 ms, an arm that follows its corrections at once. Several
   programs are asked in turn within each cycle, at equal distances, so that whatever holds the machine up hits all of them alike.
   rsi_metronome SECONDS PORT...; writes three doubles a telegram to standard output: which program (0, 1..), when the telegram was sent (s),
   and the latency (us; negative: no answer within the cycle). */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>

#define CYCLE_NS 4003000L /* no divisor of the 100 ms in which hosts ration processor time: each phase is as often hit */
#define MOST 8
#define SIX "A1=\"%.6f\" A2=\"%.6f\" A3=\"%.6f\" A4=\"%.6f\" A5=\"%.6f\" A6=\"%.6f\"/>"
#define ZERO6 "X=\"0.0\" Y=\"0.0\" Z=\"0.0\" A=\"0.0\" B=\"0.0\" C=\"0.0\"/>"

static const double START[6] = {0.0, -90.0, 90.0, 0.0, 0.0, 0.0};

struct peer { /* one program, and the arm that it moves */
    double q[6], latency;
    struct timespec sent;
    char wanted[64];
    long ipoc, delay;
    int asked, active;
};

static long since(struct timespec a)
{
    struct timespec b;
    clock_gettime(CLOCK_MONOTONIC, &b);
    return (b.tv_sec - a.tv_sec) * 1000000000L + b.tv_nsec - a.tv_nsec;
}

static void follow(const char *answer, double *q)
{
    const char *at = strstr(answer, "<AK");
    for (int k = 0; at != NULL && k < 6; k++)
        if ((at = strchr(at, '"')) != NULL) {
            q[k] = START[k] + strtod(at + 1, NULL);
            at = strchr(at + 1, '"') + 1;
        }
}

static void end_cycle(struct peer *peer, int number)
{
    if (peer->asked && peer->active) {
        double row[3] = {number, (double)peer->sent.tv_sec + (double)peer->sent.tv_nsec * 1e-9, peer->latency};
        peer->delay += peer->latency < 0.0;
        fwrite(row, sizeof row, 1, stdout);
    }
}

static void ask(struct peer *peer, int sock)
{
    char telegram[1024];
    const double *q = peer->q;
    peer->ipoc += 4;
    snprintf(telegram, sizeof telegram,
             "<Rob Type=\"KUKA\"><RIst " ZERO6 "<RSol " ZERO6 "<AIPos " SIX "<ASPos " SIX "<Delay D=\"%ld\"/><IPOC>%ld</IPOC></Rob>", q[0],
             q[1], q[2], q[3], q[4], q[5], START[0], START[1], START[2], START[3], START[4], START[5], peer->delay, peer->ipoc);
    snprintf(peer->wanted, sizeof peer->wanted, "<IPOC>%ld</IPOC>", peer->ipoc);
    peer->latency = -1.0;
    peer->asked = 1;
    clock_gettime(CLOCK_MONOTONIC, &peer->sent);
    send(sock, telegram, strlen(telegram), 0);
}

static void hear(struct peer *peer, int sock)
{
    static char answer[65536];
    ssize_t got = recv(sock, answer, sizeof answer - 1, MSG_DONTWAIT);
    long late = since(peer->sent);
    if (got <= 0)
        return;
    answer[got] = 0;
    if (peer->latency < 0.0 && late < CYCLE_NS && strstr(answer, peer->wanted) != NULL) {
        peer->latency = (double)late / 1000.0;
        peer->active = 1;
        follow(answer, peer->q);
    }
}

int main(int count, char **given)
{
    struct peer peers[MOST] = {0};
    struct pollfd ready[MOST];
    struct sched_param priority = {.sched_priority = 40};
    struct timespec next, poll_for = {0, 0};
    int programs = count - 2;

    if (programs < 1 || programs > MOST)
        return 2;
    for (int k = 0; k < programs; k++) {
        struct sockaddr_in client = {.sin_family = AF_INET, .sin_port = htons((unsigned short)atoi(given[2 + k]))};
        client.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        ready[k].fd = socket(AF_INET, SOCK_DGRAM, 0);
        ready[k].events = POLLIN;
        connect(ready[k].fd, (struct sockaddr *)&client, sizeof client);
        memcpy(peers[k].q, START, sizeof START);
        peers[k].ipoc = 1000000;
    }
    sched_setscheduler(0, SCHED_FIFO, &priority);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (long turn = 0; turn < atol(given[1]) * 250 * programs; turn++) {
        int k = (int)(turn % programs);
        end_cycle(&peers[k], k);
        next.tv_nsec += CYCLE_NS / programs;
        if (next.tv_nsec >= 1000000000L) {
            next.tv_nsec -= 1000000000L;
            next.tv_sec++;
        }
        ask(&peers[k], ready[k].fd);
        while ((poll_for.tv_nsec = -since(next)) > 0)
            if (ppoll(ready, (nfds_t)programs, &poll_for, NULL) > 0)
                for (int j = 0; j < programs; j++)
                    if (ready[j].revents)
                        hear(&peers[j], ready[j].fd);
    }
    return 0;
}
