/* A controller by the clock for benchmarks/rsi_latency.py: one RSI telegram every 4 ms, an arm that follows its corrections at once.
   rsi_metronome PORT SECONDS; writes two doubles a cycle to standard output: when its telegram was sent (s), and the latency (us; negative:
   no answer within the cycle). */
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

#define CYCLE_NS 4000000L
#define SIX "A1=\"%.6f\" A2=\"%.6f\" A3=\"%.6f\" A4=\"%.6f\" A5=\"%.6f\" A6=\"%.6f\"/>"
#define ZERO6 "X=\"0.0\" Y=\"0.0\" Z=\"0.0\" A=\"0.0\" B=\"0.0\" C=\"0.0\"/>"

static const double START[6] = {0.0, -90.0, 90.0, 0.0, 0.0, 0.0};

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

int main(int count, char **given)
{
    char telegram[1024], answer[65536], wanted[64];
    double q[6];
    struct sockaddr_in client = {.sin_family = AF_INET};
    struct sched_param priority = {.sched_priority = 40};
    struct timespec next, sent, poll_for = {0, 0};
    long ipoc = 1000000, delay = 0, cycles, active = 0;
    int sock = socket(AF_INET, SOCK_DGRAM, 0);

    if (count < 3)
        return 2;
    client.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    client.sin_port = htons((unsigned short)atoi(given[1]));
    connect(sock, (struct sockaddr *)&client, sizeof client);
    sched_setscheduler(0, SCHED_FIFO, &priority);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    memcpy(q, START, sizeof q);
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (cycles = atol(given[2]) * 250; cycles > 0; cycles--) {
        double latency = -1.0;
        ipoc += 4;
        snprintf(telegram, sizeof telegram,
                 "<Rob Type=\"KUKA\"><RIst " ZERO6 "<RSol " ZERO6 "<AIPos " SIX "<ASPos " SIX "<Delay D=\"%ld\"/><IPOC>%ld</IPOC></Rob>",
                 q[0], q[1], q[2], q[3], q[4], q[5], START[0], START[1], START[2], START[3], START[4], START[5], delay, ipoc);
        snprintf(wanted, sizeof wanted, "<IPOC>%ld</IPOC>", ipoc);
        next.tv_nsec += CYCLE_NS;
        if (next.tv_nsec >= 1000000000L) {
            next.tv_nsec -= 1000000000L;
            next.tv_sec++;
        }
        clock_gettime(CLOCK_MONOTONIC, &sent);
        send(sock, telegram, strlen(telegram), 0);
        while ((poll_for.tv_nsec = -since(next)) > 0) {
            struct pollfd ready = {.fd = sock, .events = POLLIN};
            ssize_t got;
            if (ppoll(&ready, 1, &poll_for, NULL) <= 0 || (got = recv(sock, answer, sizeof answer - 1, MSG_DONTWAIT)) <= 0)
                continue;
            answer[got] = 0;
            if (latency < 0.0 && strstr(answer, wanted) != NULL) {
                latency = (double)since(sent) / 1000.0;
                active = 1;
                follow(answer, q);
            }
        }
        if (latency < 0.0)
            delay += active;
        if (active) {
            double row[2] = {(double)sent.tv_sec + (double)sent.tv_nsec * 1e-9, latency};
            fwrite(row, sizeof row, 1, stdout);
        }
    }
    return 0;
}
