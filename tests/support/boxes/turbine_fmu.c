/* The controls of turbine_controller.c as an FMU for co-simulation: FMI 2.0, or FMI 3.0 with -DFMI3.

   Its switches are those of that file, and STATE: with get and set of its state. A step is a sample: the inputs as they
   are set, one call, the outputs. References: inputs 0-2 v, 3-5 i, 6 v_dc, 7 v_dc_ref; outputs 8-10 voltage of the
   converter, 11 limited (Boolean), 12 angle; parameters 20 on, as in the library, 29 Delay (Integer). FMI 3.0 has
   the phases as arrays, by the reference of the first. */
#include "turbine_controller.c"

#include "fmi.h"

typedef struct {
    inputs u;
    outputs y;
    parameters p;
    memory m;
} state;

typedef struct {
    state s;
    tb958_instance t;
    log_message logger;
    void *environment;
    int broken; /* for good, after a fatal answer: whoever calls it then is told so */
} fmu;

static void begin(fmu *f)
{
    memset(&f->s, 0, sizeof f->s);
    double *p = &f->s.p.k_pp;
    for (int k = 0; k < 9; k++)
        p[k] = parameter_list[k].initial.real64;
    f->s.p.fault_time = parameter_list[10].initial.real64;
}

static fmu *instance(log_message logger, void *environment)
{
    fmu *f = calloc(1, sizeof *f);
    f->t = (tb958_instance){.inputs = &f->s.u, .outputs = &f->s.y, .parameters = &f->s.p, .double_states = (double *)&f->s.m};
    f->logger = logger;
    f->environment = environment;
    begin(f);
    return f;
}

/* Where a real variable lies, and how many values it has. */
static double *real(fmu *f, unsigned reference, size_t *n)
{
    *n = 1;
#ifdef FMI3
    if (reference == 0 || reference == 3 || reference == 8)
        *n = 3;
#endif
    if (reference < 8)
        return f->s.u.v_abc + reference;
    if (reference < 11)
        return f->s.y.v_conv_abc + (reference - 8);
    if (reference == 12)
        return &f->s.y.angle;
    return reference == 30 ? &f->s.p.fault_time : &f->s.p.k_pp + (reference - 20);
}

static void say(fmu *f, status s)
{
    const char *words = s > Warning ? f->t.error_message : f->t.general_message;
    LOG(f->logger, f->environment, s, words ? words : "");
}

static status initialized(fmu *f)
{
    int answer = Model_CheckParameters(&f->t);
    if (answer != TB958_OK)
        say(f, answer == TB958_MESSAGE ? Warning : Error);
    if (answer > TB958_MESSAGE)
        return Error;
    Model_Initialize(&f->t);
    return OK;
}

static status step(fmu *f, double time)
{
    if (f->broken)
        return Fatal;
    f->t.time_s = time;
    int answer = Model_Outputs(&f->t);
#ifdef FAULT_FATAL
    f->broken = time >= f->s.p.fault_time;
    if (f->broken)
        return Fatal;
#endif
    if (answer == TB958_OK)
        return OK;
    status s = answer == TB958_MESSAGE ? Warning : Error;
    say(f, s);
    return s;
}

#ifdef FAULT_END
#define ENDS(c, time) ((time) >= ((fmu *)c)->s.p.fault_time)
#else
#define ENDS(c, time) false
#endif
DO_STEP(step((fmu *)c, time), ENDS(c, time))
INSTANTIATE(instance)

void FMI(FreeInstance)(void *c) { free(c); }

int FMI(ExitInitializationMode)(void *c) { return initialized(c); }

int FMI(Reset)(void *c)
{
    begin(c);
    return OK;
}

int NAMED(SetReal)(void *c, const unsigned at[], size_t n, const double x[] VALUES)
{
    size_t width;
    for (size_t k = 0; k < n; k++, x += width) {
        double *to = real(c, at[k], &width);
        memcpy(to, x, width * sizeof *x);
    }
    return OK;
}

int NAMED(GetReal)(void *c, const unsigned at[], size_t n, double x[] VALUES)
{
    size_t width;
    for (size_t k = 0; k < n; k++, x += width) {
        const double *from = real(c, at[k], &width);
        memcpy(x, from, width * sizeof *x);
    }
    return OK;
}

int NAMED(SetInteger)(void *c, const unsigned at[], size_t n, const integer x[] VALUES)
{
    (void)at, (void)n;
    ((fmu *)c)->s.p.delay = x[0];
    return OK;
}

int FMI(GetBoolean)(void *c, const unsigned at[], size_t n, boolean x[] VALUES)
{
    (void)at, (void)n;
    x[0] = ((fmu *)c)->s.y.limited != 0;
    return OK;
}

int NAMED(GetFMUstate)(void *c, void **to)
{
#ifdef STATE
    if (!*to)
        *to = malloc(sizeof(state));
    memcpy(*to, &((fmu *)c)->s, sizeof(state));
    return OK;
#else
    return (void)c, (void)to, Error;
#endif
}

int NAMED(SetFMUstate)(void *c, void *from)
{
#ifdef STATE
    memcpy(&((fmu *)c)->s, from, sizeof(state));
    return OK;
#else
    return (void)c, (void)from, Error;
#endif
}

int NAMED(FreeFMUstate)(void *c, void **from)
{
    (void)c;
    free(*from);
    *from = NULL;
    return OK;
}

NONE(GetInteger) NONE(SetBoolean) UNUSED
