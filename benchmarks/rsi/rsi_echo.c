/* The least that answers an RSI telegram: finds <IPOC>, joins it to a fixed answer, sends. The floor of benchmarks/rsi.py latency.
   cc -O2 -o rsi_echo rsi_echo.c; rsi_echo PORT [seconds] */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const char HEAD[] =
    "<Sen Type=\"ImFree\"><Stop>0</Stop><AK A1=\"0.000000\" A2=\"0.000000\" A3=\"0.000000\" "
    "A4=\"0.000000\" A5=\"0.000000\" A6=\"0.000000\"/>";
static const char TAIL[] = "</IPOC></Sen>";

int main(int count, char **given)
{
    char data[65536], answer[512];
    struct sockaddr_in here = {.sin_family = AF_INET}, sender;
    struct timeval wait = {.tv_sec = 0, .tv_usec = 20000};
    struct sched_param priority = {.sched_priority = 50};
    socklen_t size;
    int sock = socket(AF_INET, SOCK_DGRAM, 0);
    time_t end;

    if (count < 2)
        return 2;
    end = time(NULL) + (count > 2 ? atoi(given[2]) : 3600);
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    here.sin_port = htons((unsigned short)atoi(given[1]));
    if (bind(sock, (struct sockaddr *)&here, sizeof here) != 0)
        return 1;
    setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
    sched_setscheduler(0, SCHED_FIFO, &priority); /* both only where it is permitted */
    mlockall(MCL_CURRENT | MCL_FUTURE);
    memcpy(answer, HEAD, sizeof HEAD - 1);
    puts("up");
    fflush(stdout);
    while (time(NULL) < end) {
        size = sizeof sender;
        ssize_t got = recvfrom(sock, data, sizeof data - 1, 0, (struct sockaddr *)&sender, &size);
        char *ipoc, *close;
        size_t length;
        if (got <= 0)
            continue;
        data[got] = 0;
        ipoc = strstr(data, "<IPOC>");
        close = ipoc ? strstr(ipoc, "</IPOC>") : NULL;
        if (close == NULL || close - ipoc > 64)
            continue;
        length = (size_t)(close - ipoc);
        memcpy(answer + sizeof HEAD - 1, ipoc, length);
        memcpy(answer + sizeof HEAD - 1 + length, TAIL, sizeof TAIL - 1);
        sendto(sock, answer, sizeof HEAD - 1 + length + sizeof TAIL - 1, 0, (struct sockaddr *)&sender, size);
    }
    close(sock);
    return 0;
}
