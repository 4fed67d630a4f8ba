/* Our own declaration of the binary interface of CIGRE TB 958 (IEEE/CIGRE real-code models, API 2):
   only what a small controller needs, laid out as the brochure prescribes. */
#ifndef TB958_H
#define TB958_H

#include <stdint.h>

enum tb958_type {
    TB958_CHAR = 1,
    TB958_INT8,
    TB958_UINT8,
    TB958_INT16,
    TB958_UINT16,
    TB958_INT32,
    TB958_UINT32,
    TB958_REAL32,
    TB958_REAL64,
    TB958_STRING
};

enum tb958_return { TB958_OK = 0, TB958_MESSAGE = 1, TB958_ERROR = 2 };

typedef union {
    char character;
    const char *string;
    int8_t int8;
    uint8_t uint8;
    int16_t int16;
    uint16_t uint16;
    int32_t int32;
    uint32_t uint32;
    float real32;
    double real64;
} tb958_value;

typedef struct {
    const char *name, *description, *unit;
    int type;
    int32_t width;
} tb958_signal;

typedef struct {
    const char *name, *group, *description, *unit;
    int type;
    int32_t fixed;
    tb958_value initial, lowest, highest;
} tb958_parameter;

typedef struct {
    uint8_t interface_version[4];
    const char *name, *version, *description, *general, *created, *creator;
    const char *modified_date, *modified_by, *modified_comment, *modified_history;
    double sample_time_s;
    uint8_t emt_rms;
    int32_t n_inputs;
    const tb958_signal *inputs;
    int32_t n_outputs;
    const tb958_signal *outputs;
    int32_t n_parameters;
    const tb958_parameter *parameters;
    int32_t n_int_states, n_float_states, n_double_states;
} tb958_info;

typedef struct {
    void *inputs, *outputs, *parameters;
    double time_s;
    uint8_t emt_rms;
    const char *error_message, *general_message;
    int32_t *int_states;
    float *float_states;
    double *double_states;
} tb958_instance;

#ifdef _WIN32
#define TB958_EXPORT __declspec(dllexport)
#else
#define TB958_EXPORT __attribute__((visibility("default")))
#endif

#endif
