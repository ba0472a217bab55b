/* A vehicle held 1 m above the place where it is first heard, by this bundle's kernel and alula_tick alone:
 *
 *   cc -O2 -ffp-contract=off tick_example.c tick.c ../kernel.so -Wl,-rpath,.. -o example -lm && ./example 14540
 *
 * It answers PX4's ODOMETRY on a UDP port with SET_ATTITUDE_TARGET; arming and OFFBOARD are left to you. An empty
 * datagram ends it. Beside a network the kernel is physics.so (tick_vehicle.h). */
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>

#include "tick_node.h"

int main(int count, char **words) {
    static alula_node node;
    static uint8_t bytes[65536];
    struct sockaddr_in here = {.sin_family = AF_INET}, vehicle;
    int answered = 0, left[32] = {0};
    const int udp = socket(AF_INET, SOCK_DGRAM, 0);
    here.sin_port = htons((uint16_t)atoi(count > 1 ? words[1] : "14540"));
    if (bind(udp, (struct sockaddr *)&here, sizeof here)) return 1;
    alula_open(&node, 1, 1);
    for (;;) {
        socklen_t length = sizeof vehicle;
        const int size = (int)recvfrom(udp, bytes, sizeof bytes, 0, (struct sockaddr *)&vehicle, &length);
        const double received = alula_now();
        if (size <= 0) break;
        if (node.context.link.socket < 0) { /* the first estimate: hold its place, 1 m higher */
            if (alula_start(&node, bytes, size, received)) continue;
            for (int k = 0; k <= ALULA_NODES; k++) {
                memcpy(node.reference[k], node.result.acting, sizeof node.reference[k]);
                memset(node.reference[k] + 3, 0, 3 * sizeof(double)), node.reference[k][2] += 1;
            }
            if (connect(udp, (struct sockaddr *)&vehicle, length)) return 1;
            node.context.link.socket = udp;
        } else {
            const int reason = alula_step(&node, bytes, size, received);
            if (reason) left[reason]++;
            if (reason) continue; /* a node that flies has another way for this: hold, land, or tell the pilot */
            answered++;
        }
        if (alula_prepare(&node)) return 1;
    }
    printf("%d answered", answered);
    for (int reason = 1; reason < 32; reason++) printf(", %d", left[reason]);
    printf("\n");
    return 0;
}
