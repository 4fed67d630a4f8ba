/* What a build misbehaves in, from FaultTime on: -DFAULT_ERROR, -DFAULT_NAN, ... One at a time. */
#include <stdio.h>
#include <stdlib.h>

#include "manners.h"

#ifdef FAULT_WIDTH
#define DECLARED_WIDTH 1 /* the model writes three */
#else
#define DECLARED_WIDTH 3
#endif

#ifdef FAULT_STATES
#define DECLARED_DOUBLES (N_DOUBLES - 3) /* the model uses them all */
#else
#define DECLARED_DOUBLES N_DOUBLES
#endif

#ifdef FAULT_SLEEP
#include <unistd.h>
#endif

static int32_t fault(tb958_instance *instance)
{
#if defined FAULT_ERROR
    instance->error_message = "DC overvoltage, converter blocked";
    return TB958_ERROR;
#elif defined FAULT_NAN
    ((outputs *)instance->outputs)->v_conv_abc[1] = NAN;
#elif defined FAULT_PRINT
    puts("controller: still here");
#elif defined FAULT_MESSAGE
    instance->general_message = "temperature sensor missing, assuming 40 C";
    return TB958_MESSAGE;
#elif defined FAULT_SLEEP
    sleep(3600);
#elif defined FAULT_LEAK
    memset(malloc(1000), 1, 1000);
#elif defined FAULT_ABORT
    abort();
#elif defined FAULT_EXIT
    exit(7);
#elif defined FAULT_SEGV
    static volatile int *volatile nowhere;
    *nowhere = 1;
#endif
    (void)instance;
    bad_manners();
    return TB958_OK;
}
