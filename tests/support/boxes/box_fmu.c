/* An FMU for co-simulation for the tests, FMI 2.0 or (-DFMI3) 3.0, in several builds (-D):

   CONVERTER       a grid-following converter: PLL, current control, inductor; else an R-L branch
   STATE           with get and set of its state
   HIDDEN          its state stands in statics, where no instance and no snapshot reaches it

   Real variables: 0-2 v_a v_b v_c, 3-5 i_a i_b i_c (load direction), 6 p_w, 7 fault, 8 after_s, 9 k_pll, 10 v_alpha,
   11 v_beta, 12 i_alpha, 13 i_beta; FMI 3.0 has the phases as arrays too. From after_s on it misbehaves as `fault` says; fault -1: as p_w says, in MW. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "counted.h"
#include "fmi.h"
#include "manners.h"

#define THIRD 2.0943951023931953
enum { FINE, ERRS, PRINTS, SLEEPS, LEAKS, NANS, ABORTS, SEGFAULTS, DISCARDS, DIES, IS_RUDE };

typedef struct {
    double r[16], i[3], theta, x_pll, x_d, x_q, t;
} State;

typedef struct {
    State s;
    log_message logger;
    void *environment;
    int broken; /* for good, after a fatal answer: whoever calls it then is told so */
} Instance;

#ifdef HIDDEN
static State hidden;
#define STATE_OF(c) (&hidden)
#else
#define STATE_OF(c) (&((Instance *)(c))->s)
#endif

static void begin(State *s) {
    memset(s, 0, sizeof *s);
    s->r[9] = 0.5;
}

static void terminals(State *s) { /* alpha and beta, where they are used, in place of the phases */
    if (s->r[10] != 0.0 || s->r[11] != 0.0)
        for (int k = 0; k < 3; k++) s->r[k] = s->r[10] * cos(k * THIRD) + s->r[11] * sin(k * THIRD);
}

static void branch(State *s, double h) { /* L di/dt = v - R i, v held: exact */
    const double decay = exp(-0.1 * h / 1e-3), gain = (1.0 - decay) / 0.1;
    for (int k = 0; k < 3; k++) s->i[k] = decay * s->i[k] + gain * s->r[k];
}

static void converter(State *s, double h) {
    const double R = 3e-3, L = 0.2e-3, w1 = 314.15926535897931;
    double c[3], n[3], v_d = 0, v_q = 0, i_d = 0, i_q = 0, *v = s->r;
    for (int k = 0; k < 3; k++) {
        c[k] = cos(s->theta - k * THIRD);
        n[k] = sin(s->theta - k * THIRD);
        v_d += v[k] * c[k] * 2 / 3;
        v_q -= v[k] * n[k] * 2 / 3;
        i_d -= s->i[k] * c[k] * 2 / 3; /* out of the converter */
        i_q += s->i[k] * n[k] * 2 / 3;
    }
    double wanted = s->r[6] / (1.5 * fmax(fabs(v_d), 100.0)), e_d = wanted - i_d, e_q = -i_q;
    s->x_pll += h * 10.0 * v_q;
    s->theta += h * (w1 + s->r[9] * v_q + s->x_pll);
    if (s->theta > 6.283185307179586) s->theta -= 6.283185307179586;
    s->x_d += h * 40.0 * e_d;
    s->x_q += h * 40.0 * e_q;
    double u_d = 0.9 * v_d + 0.3 * e_d + s->x_d - w1 * L * i_q, u_q = 0.3 * e_q + s->x_q + w1 * L * i_d;
    for (int k = 0; k < 3; k++) {
        double u = u_d * c[k] - u_q * n[k];
        s->i[k] += h / L * (v[k] - u - R * s->i[k]);
    }
}

static volatile int *volatile nowhere;

static status misbehave(Instance *c, State *s) {
    int fault = (int)(s->r[7] < 0 ? s->r[6] / 1e6 + 0.5 : s->r[7]);
    if (s->t < s->r[8]) return OK;
    switch (fault) {
    case ERRS:
        LOG(c->logger, c->environment, Error, "theta left the circle");
        return Error;
    case PRINTS:
        printf("step at %g s: all is well, and here is a long line about it\n", s->t);
        break;
    case SLEEPS:
        sleep(600);
        break;
    case LEAKS: {
        char *leak = malloc(4096);
        if (leak) memset(leak, 1, 4096);
        break;
    }
    case NANS:
        for (int k = 0; k < 3; k++) s->r[3 + k] = NAN;
        s->r[12] = s->r[13] = NAN;
        break;
    case ABORTS:
        fprintf(stderr, "\nassertion failed: theta < 2 pi\n"); /* what was printed before may end within a line */
        abort();
    case SEGFAULTS:
        *nowhere = 1;
        break;
    case DISCARDS:
        return Discard;
    case DIES:
        c->broken = 1;
        return Fatal;
    case IS_RUDE: /* see manners.h */
        bad_manners();
        break;
    }
    return OK;
}

static status step(Instance *c, double time, double size) {
    State *s = STATE_OF(c);
    if (c->broken) return Fatal;
    s->t = time;
    count_a_step();
    terminals(s);
#ifdef CONVERTER
    (void)branch;
    converter(s, size);
#else
    (void)converter;
    branch(s, size);
#endif
    memcpy(s->r + 3, s->i, sizeof s->i);
    s->r[12] = 2.0 / 3.0 * (s->i[0] - 0.5 * s->i[1] - 0.5 * s->i[2]);
    s->r[13] = (s->i[1] - s->i[2]) / sqrt(3.0);
    return misbehave(c, s);
}

static Instance *instance(log_message logger, void *environment) {
    Instance *c = calloc(1, sizeof *c);
    c->logger = logger;
    c->environment = environment;
    begin(STATE_OF(c));
    return c;
}

DO_STEP(step((Instance *)c, time, size), false)
INSTANTIATE(instance)

void FMI(FreeInstance)(void *c) { free(c); }

int FMI(Reset)(void *c) {
#ifndef HIDDEN /* the sloppy one forgets */
    begin(STATE_OF(c));
#endif
    (void)c;
    return OK;
}

/* One value each; an array by its first: v_abc and i_abc are the phases from reference 20 and 23 on. */
static double *real(void *c, unsigned reference, size_t *n) {
    *n = reference >= 20 ? 3 : 1;
    return STATE_OF(c)->r + (reference >= 20 ? reference - 20 : reference);
}

int NAMED(GetReal)(void *c, const unsigned at[], size_t n, double x[] VALUES) {
    size_t width;
    for (size_t k = 0; k < n; k++, x += width) {
        const double *from = real(c, at[k], &width);
        memcpy(x, from, width * sizeof *x);
    }
    return OK;
}

int NAMED(SetReal)(void *c, const unsigned at[], size_t n, const double x[] VALUES) {
    size_t width;
    for (size_t k = 0; k < n; k++, x += width) {
        double *to = real(c, at[k], &width);
        memcpy(to, x, width * sizeof *x);
    }
    return OK;
}

#ifdef STATE
int NAMED(GetFMUstate)(void *c, void **to) {
    if (!*to) *to = malloc(sizeof(State));
    memcpy(*to, STATE_OF(c), sizeof(State));
    return OK;
}
int NAMED(SetFMUstate)(void *c, void *from) {
    memcpy(STATE_OF(c), from, sizeof(State));
    return OK;
}
#else
int NAMED(GetFMUstate)(void *c, void **to) { return (void)c, (void)to, Error; }
int NAMED(SetFMUstate)(void *c, void *from) { return (void)c, (void)from, Error; }
#endif
int NAMED(FreeFMUstate)(void *c, void **from) {
    (void)c;
    free(*from);
    *from = NULL;
    return OK;
}

NONE(ExitInitializationMode) NONE(GetInteger) NONE(SetInteger) NONE(GetBoolean) NONE(SetBoolean) UNUSED
