/* FMI 2.0, or FMI 3.0 with -DFMI3, as far as two small FMUs for co-simulation need it: one source for both.

   NAMED(SetReal) is fmi2SetReal, or fmi3SetFloat64 with the number of values behind it, VALUES. */
#ifndef FMI_H
#define FMI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define UNNEEDED __attribute__((unused))
#define NAMED(name) FMI(name) /* expands the name first */

#ifdef FMI3
#define FMI(name) fmi3##name
#define VALUES , UNNEEDED size_t n_values
#define SetReal SetFloat64
#define GetReal GetFloat64
#define SetInteger SetInt32
#define GetInteger GetInt32
#define GetFMUstate GetFMUState
#define SetFMUstate SetFMUState
#define FreeFMUstate FreeFMUState
typedef int32_t integer;
typedef bool boolean;
typedef enum { OK, Warning, Discard, Error, Fatal } status;
typedef void (*log_message)(void *environment, status, const char *category, const char *message);
#define LOG(logger, environment, s, words) (logger)((environment), (s), "box", (words))
#else
#define FMI(name) fmi2##name
#define VALUES
typedef int integer;
typedef int boolean;
typedef enum { OK, Warning, Discard, Error, Fatal, Pending } status;
typedef void (*log_message)(void *environment, const char *name, status, const char *category, const char *message, ...);
#define LOG(logger, environment, s, words) (logger)((environment), "box", (s), "box", "%s", (words))
typedef struct {
    log_message logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished, *environment;
} callbacks;
#endif

/* The step, whose answer is `doing`, and whether it `ends` the simulation, which only FMI 3.0 can say; and the making of
   an instance by `make(log_message, void *environment)`. */
#ifdef FMI3
#define DO_STEP(doing, ends)                                                                                          \
    int fmi3DoStep(void *c, double time, double size, UNNEEDED bool back, bool *event, bool *end, bool *early,        \
                   double *last)                                                                                      \
    {                                                                                                                 \
        *event = *early = false;                                                                                      \
        *end = ends;                                                                                                  \
        *last = time + size;                                                                                          \
        return doing;                                                                                                 \
    }
#define INSTANTIATE(make)                                                                                             \
    void *fmi3InstantiateCoSimulation(UNNEEDED const char *name, UNNEEDED const char *token,                          \
                                      UNNEEDED const char *where, UNNEEDED bool visible, UNNEEDED bool logging,       \
                                      UNNEEDED bool events, UNNEEDED bool early, UNNEEDED const unsigned *needed,     \
                                      UNNEEDED size_t n, void *environment, log_message logger,                       \
                                      UNNEEDED void *update)                                                          \
    {                                                                                                                 \
        return make(logger, environment);                                                                             \
    }
#else
#define DO_STEP(doing, ends)                                                                                          \
    int fmi2DoStep(void *c, double time, UNNEEDED double size, UNNEEDED int back) { return doing; }
#define INSTANTIATE(make)                                                                                             \
    void *fmi2Instantiate(UNNEEDED const char *name, UNNEEDED int type, UNNEEDED const char *guid,                    \
                          UNNEEDED const char *where, const callbacks *host, UNNEEDED int visible,                    \
                          UNNEEDED int logging)                                                                       \
    {                                                                                                                 \
        return make(host ? host->logger : NULL, host ? host->environment : NULL);                                     \
    }
#endif

/* What the standard wants to be there, and nobody here calls, or whose answer is all that counts. */
#define NONE(name) \
    int NAMED(name)(void) { return OK; }
#define UNUSED_2_AND_3                                                                                                \
    NONE(GetVersion) NONE(SetDebugLogging) NONE(EnterInitializationMode) NONE(Terminate) NONE(GetString)              \
    NONE(SetString) NONE(GetDirectionalDerivative)
#ifdef FMI3
#define UNUSED                                                                                                        \
    UNUSED_2_AND_3 NONE(InstantiateModelExchange) NONE(InstantiateScheduledExecution) NONE(EnterEventMode)            \
    NONE(GetFloat32) NONE(GetInt8) NONE(GetUInt8) NONE(GetInt16) NONE(GetUInt16) NONE(GetUInt32) NONE(GetInt64)       \
    NONE(GetUInt64) NONE(GetBinary) NONE(GetClock) NONE(SetFloat32) NONE(SetInt8) NONE(SetUInt8) NONE(SetInt16)       \
    NONE(SetUInt16) NONE(SetUInt32) NONE(SetInt64) NONE(SetUInt64) NONE(SetBinary) NONE(SetClock)                     \
    NONE(GetNumberOfVariableDependencies) NONE(GetVariableDependencies) NONE(SerializedFMUStateSize)                  \
    NONE(SerializeFMUState) NONE(DeserializeFMUState) NONE(GetAdjointDerivative) NONE(EnterConfigurationMode)         \
    NONE(ExitConfigurationMode) NONE(GetIntervalDecimal) NONE(GetIntervalFraction) NONE(GetShiftDecimal)              \
    NONE(GetShiftFraction) NONE(SetIntervalDecimal) NONE(SetIntervalFraction) NONE(SetShiftDecimal)                   \
    NONE(SetShiftFraction) NONE(EvaluateDiscreteStates) NONE(UpdateDiscreteStates) NONE(EnterContinuousTimeMode)      \
    NONE(CompletedIntegratorStep) NONE(SetTime) NONE(SetContinuousStates) NONE(GetContinuousStateDerivatives)         \
    NONE(GetEventIndicators) NONE(GetContinuousStates) NONE(GetNominalsOfContinuousStates)                            \
    NONE(GetNumberOfEventIndicators) NONE(GetNumberOfContinuousStates) NONE(EnterStepMode)                            \
    NONE(GetOutputDerivatives) NONE(ActivateModelPartition)
#else
#define UNUSED                                                                                                        \
    UNUSED_2_AND_3 NONE(GetTypesPlatform) NONE(SetupExperiment) NONE(SerializedFMUstateSize)                          \
    NONE(SerializeFMUstate) NONE(DeSerializeFMUstate) NONE(SetRealInputDerivatives)                                   \
    NONE(GetRealOutputDerivatives) NONE(CancelStep) NONE(GetStatus) NONE(GetRealStatus) NONE(GetIntegerStatus)        \
    NONE(GetBooleanStatus) NONE(GetStringStatus)
#endif

#endif
