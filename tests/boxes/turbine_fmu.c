/* The controls of turbine_controller.c as an FMU for co-simulation: FMI 2.0, or FMI 3.0 with -DFMI3.

   Its switches are those of that file, and STATE: with get and set of its state. A step is a sample: the inputs as they
   are set, one call, the outputs. References: inputs 0-2 v, 3-5 i, 6 v_dc, 7 v_dc_ref; outputs 8-10 voltage of the
   converter, 11 limited (Boolean), 12 angle; parameters 20 on, as in the library, 29 Delay (Integer). FMI 3.0 has
   the phases as arrays, by the reference of the first. */
#include "turbine_controller.c"

#ifdef FMI3
#include "fmi3PlatformTypes.h"
typedef enum { OK, Warning, Discard, Error, Fatal } status;
typedef void (*log_message)(void *environment, status, const char *category, const char *message);
#define FMI(name) fmi3##name
#define VALUES , __attribute__((unused)) size_t n_values
#else
#include "fmi2TypesPlatform.h"
typedef enum { OK, Warning, Discard, Error, Fatal, Pending } status;
typedef void (*log_message)(void *environment, const char *name, status, const char *category, const char *message, ...);
typedef struct {
    log_message logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished, *environment;
} callbacks;
#define FMI(name) fmi2##name
#define VALUES
#endif

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
#ifdef FMI3
    f->logger(f->environment, s, "control", words ? words : "");
#else
    f->logger(f->environment, "control", s, "control", "%s", words ? words : "");
#endif
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

#ifdef FMI3
int FMI(DoStep)(void *c, double time, double size, bool back, bool *event, bool *end, bool *early, double *last)
{
    (void)back;
    *event = *early = false;
    *end = false;
    *last = time + size;
#ifdef FAULT_END
    *end = time >= ((fmu *)c)->s.p.fault_time;
#endif
    return step(c, time);
}

void *FMI(InstantiateCoSimulation)(const char *name, const char *token, const char *where, bool visible, bool logging,
                                   bool events, bool early, const unsigned *needed, size_t n, void *environment,
                                   log_message logger, void *update)
{
    (void)name, (void)token, (void)where, (void)visible, (void)logging, (void)events, (void)early, (void)needed, (void)n;
    (void)update;
    return instance(logger, environment);
}
#else
int FMI(DoStep)(void *c, double time, double size, int back)
{
    (void)size, (void)back;
    return step(c, time);
}

void *FMI(Instantiate)(const char *name, int type, const char *guid, const char *where, const callbacks *of_host,
                       int visible, int logging)
{
    (void)name, (void)type, (void)guid, (void)where, (void)visible, (void)logging;
    return instance(of_host->logger, of_host->environment);
}
#endif

void FMI(FreeInstance)(void *c) { free(c); }

int FMI(ExitInitializationMode)(void *c) { return initialized(c); }

int FMI(Reset)(void *c)
{
    begin(c);
    return OK;
}

#ifdef FMI3
#define SetReal SetFloat64
#define GetReal GetFloat64
#define SetInteger SetInt32
#define INTEGER int32_t
#define BOOLEAN bool
#else
#define INTEGER int
#define BOOLEAN int
#endif
#define NAMED(name) FMI(name) /* expands the name first */

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

int NAMED(SetInteger)(void *c, const unsigned at[], size_t n, const INTEGER x[] VALUES)
{
    (void)at, (void)n;
    ((fmu *)c)->s.p.delay = x[0];
    return OK;
}

int FMI(GetBoolean)(void *c, const unsigned at[], size_t n, BOOLEAN x[] VALUES)
{
    (void)at, (void)n;
    x[0] = ((fmu *)c)->s.y.limited != 0;
    return OK;
}

#ifdef FMI3
#define GetFMUstate GetFMUState
#define SetFMUstate SetFMUState
#define FreeFMUstate FreeFMUState
#endif

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

/* What the standard wants to be there, and nobody here calls, or whose answer is all that counts. */
#define NONE(name) \
    int FMI(name)(void) { return OK; }
NONE(GetVersion) NONE(SetDebugLogging) NONE(EnterInitializationMode) NONE(Terminate) NONE(GetString) NONE(SetString)
NONE(SetBoolean) NONE(GetDirectionalDerivative)
#ifdef FMI3
NONE(InstantiateModelExchange) NONE(InstantiateScheduledExecution) NONE(EnterEventMode) NONE(GetFloat32) NONE(GetInt8)
NONE(GetUInt8) NONE(GetInt16) NONE(GetUInt16) NONE(GetInt32) NONE(GetUInt32) NONE(GetInt64) NONE(GetUInt64)
NONE(GetBinary) NONE(GetClock) NONE(SetFloat32) NONE(SetInt8) NONE(SetUInt8) NONE(SetInt16) NONE(SetUInt16)
NONE(SetUInt32) NONE(SetInt64) NONE(SetUInt64) NONE(SetBinary) NONE(SetClock) NONE(GetNumberOfVariableDependencies)
NONE(GetVariableDependencies) NONE(SerializedFMUStateSize) NONE(SerializeFMUState) NONE(DeserializeFMUState)
NONE(GetAdjointDerivative) NONE(EnterConfigurationMode) NONE(ExitConfigurationMode) NONE(GetIntervalDecimal)
NONE(GetIntervalFraction) NONE(GetShiftDecimal) NONE(GetShiftFraction) NONE(SetIntervalDecimal)
NONE(SetIntervalFraction) NONE(SetShiftDecimal) NONE(SetShiftFraction) NONE(EvaluateDiscreteStates)
NONE(UpdateDiscreteStates) NONE(EnterContinuousTimeMode) NONE(CompletedIntegratorStep) NONE(SetTime)
NONE(SetContinuousStates) NONE(GetContinuousStateDerivatives) NONE(GetEventIndicators) NONE(GetContinuousStates)
NONE(GetNominalsOfContinuousStates) NONE(GetNumberOfEventIndicators) NONE(GetNumberOfContinuousStates)
NONE(EnterStepMode) NONE(GetOutputDerivatives) NONE(ActivateModelPartition)
#else
NONE(GetTypesPlatform) NONE(SetupExperiment) NONE(GetInteger) NONE(SerializedFMUstateSize) NONE(SerializeFMUstate)
NONE(DeSerializeFMUstate) NONE(SetRealInputDerivatives) NONE(GetRealOutputDerivatives) NONE(CancelStep) NONE(GetStatus)
NONE(GetRealStatus) NONE(GetIntegerStatus) NONE(GetBooleanStatus) NONE(GetStringStatus)
#endif
