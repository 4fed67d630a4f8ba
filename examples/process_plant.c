/* An R-L branch as a program for seqsweep, without snapshots: it is replayed from cold.

       cc -O2 -o process_plant process_plant.c -lm && seqsweep check process:./process_plant
*/
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define R_OHM 0.1
#define L_H 1e-3
#define DT_S 50e-6

static char content[65536]; /* a STEP holds at most 4096 complex voltages */

static void get(void *to, size_t n) {
    if (fread(to, 1, n, stdin) != n) exit(0); /* the end of the stream is the end of the program */
}

static void answer(const char *tag, const void *from, uint32_t n) {
    fwrite(tag, 1, 4, stdout);
    fwrite(&n, 4, 1, stdout); /* little-endian, as this machine is */
    fwrite(from, 1, n, stdout);
    fflush(stdout);
}

int main(void) {
    const char *card = "{\"version\": 1, \"f1_hz\": 50, \"dt_s\": 50e-6, \"voltage_v\": 690, \"power_va\": 1e6}";
    const double decay = exp(-R_OHM * DT_S / L_H), gain = (1.0 - decay) / R_OHM;
    double i[2] = {0.0, 0.0}, *v = (double *)content;
    for (;;) {
        char tag[5] = "";
        uint32_t n;
        get(tag, 4);
        get(&n, 4);
        if (n > sizeof content) {
            answer("FAIL", "the frame is too long", 21);
            return 1;
        }
        get(content, n);
        if (!strcmp(tag, "HELO")) {
            answer(tag, card, (uint32_t)strlen(card));
        } else if (!strcmp(tag, "ZERO")) {
            i[0] = i[1] = 0.0;
            answer(tag, "", 0);
        } else if (!strcmp(tag, "STEP")) {
            for (uint32_t k = 0; k < n / 8; k++) /* alpha and beta in turn */
                v[k] = i[k % 2] = decay * i[k % 2] + gain * v[k];
            answer(tag, content, n);
        } else {
            answer("FAIL", "no such question", 16);
        }
    }
}
