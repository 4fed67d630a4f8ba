/* The grid-side controls of the reference turbine (PLL, DC voltage, current) as a TB 958 library.

   cc -O2 -shared -fPIC -o turbine_controller.so turbine_controller.c -lm

   Sampled every SAMPLE_TIME_S; the host holds the outputs in between. Integrators live in the middle
   of the interval for which the output is held, so that the sum is of second order; what is measured
   is extrapolated there by a parabola through three samples (Lead, in samples: 0.5 is the middle of
   the hold, 1.5 with one sample of delay, 0 is a plain sampled control).

   Space vectors are power-invariant in here, ports are phase quantities: V and A, current out of the
   converter. Switches: HIDDEN_STATES keeps the state in statics instead of the declared arrays,
   BARE exports Model_GetInfo and Model_Outputs alone, SINGLE has float ports, PER_UNIT tells
   everything differently (see below), UNTIMED names no sample time, RMS is no
   model for programs in time; see also faults.h and counted.h. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "tb958.h"

#ifndef SAMPLE_TIME_S
#define SAMPLE_TIME_S 20e-6
#endif
#define T SAMPLE_TIME_S
#define W1 314.15926535897931

#ifdef SINGLE
typedef float port;
#define PORT TB958_REAL32
#else
typedef double port;
#define PORT TB958_REAL64
#endif

/* One of a port's units in SI, with the sign. PER_UNIT: voltage in pu of 500 V, current in kA into the
   converter, DC voltage in kV, and a modulation index instead of a voltage. */
#ifdef PER_UNIT
enum { MODULATES = 1 };
#define V_UNIT "pu"
#define I_UNIT "kA"
#define DC_UNIT "kV"
#define OUT_UNIT ""
static const double v_unit = 500.0, i_unit = -1e3, dc_unit = 1e3;
#else
enum { MODULATES = 0 };
#define V_UNIT "V"
#define I_UNIT "A"
#define DC_UNIT "V"
#define OUT_UNIT "V"
static const double v_unit = 1.0, i_unit = 1.0, dc_unit = 1.0;
#endif

typedef struct {
    port v_abc[3], i_abc[3], v_dc, v_dc_ref;
} inputs;

typedef struct {
    port v_conv_abc[3];
    int32_t limited;
    port angle;
} outputs;

typedef struct {
    double k_pp, k_pi, k_p, k_i, k_rd, k_dcp, k_dci, i_limit, lead;
    int32_t delay;
    double fault_time;
} parameters;

/* Everything that is remembered: all doubles, so that it fits the declared array. */
typedef struct {
    double started, theta, x_pll, xi_dc, xi_d, xi_q;
    double v_q[2], i_d[2], i_q[2], v_dc[2]; /* one and two samples ago */
    double held[3];                         /* last command, for a delay */
} memory;

#define N_DOUBLES ((int)(sizeof(memory) / sizeof(double)))

#include "counted.h"
#include "faults.h"

static const tb958_signal input_ports[] = {
    {"v_abc", "voltage at the terminals, phase to neutral", V_UNIT, PORT, 3},
    {"i_abc", "current of the converter", I_UNIT, PORT, 3},
    {"v_dc", "voltage of the DC link", DC_UNIT, PORT, 1},
    {"v_dc_ref", "its reference", DC_UNIT, PORT, 1},
};

static const tb958_signal output_ports[] = {
    {"v_conv_abc", "voltage of the converter, phase to neutral", OUT_UNIT, PORT, DECLARED_WIDTH},
    {"limited", "1 while a limit acts", "", TB958_INT32, 1},
    {"angle", "angle of the phase-locked loop", "rad", PORT, 1},
};

#define REAL(name, about, unit, value, low, high)                                                                     \
    {name, "control", about, unit, TB958_REAL64, 0, {.real64 = value}, {.real64 = low}, {.real64 = high}}

static const tb958_parameter parameter_list[] = {
    REAL("Kpp", "PLL, proportional", "rad/s/V", 0.085, 0.0, 10.0),
    REAL("Kpi", "PLL, integral", "rad/s2/V", 32.0, 0.0, 1e4),
    REAL("Kp", "current, proportional", "ohm", 0.25, 0.0, 10.0),
    REAL("Ki", "current, integral", "ohm/s", 355.0, 0.0, 1e5),
    REAL("Krd", "current, decoupling", "ohm", 0.0471, 0.0, 10.0),
    REAL("Kdcp", "DC voltage, proportional", "A/V", 0.5, 0.0, 100.0),
    REAL("Kdci", "DC voltage, integral", "A/V/s", 5.0, 0.0, 1e4),
    REAL("Imax", "limit of the current, power-invariant", "A", 1.2 * 1.632e6 / 690.0, 0.0, 1e5),
    REAL("Lead", "how far ahead the control looks", "samples", 0.5, 0.0, 2.0),
    {"Delay", "control", "samples by which the output is late", "", TB958_INT32, 1, {.int32 = 0}, {.int32 = 0}, {.int32 = 1}},
    REAL("FaultTime", "time from which a faulty build misbehaves", "s", 1e30, 0.0, 1e30),
};

static const tb958_info info = {
    .interface_version = {1, 1, 0, 0},
    .name = "TurbineController",
    .version = "1.0",
    .description = "Grid-side controls of a wind turbine",
    .general = "PLL, DC voltage and current control, sampled",
#ifndef UNTIMED
    .sample_time_s = T,
#endif
#ifdef RMS
    .emt_rms = 2,
#else
    .emt_rms = 1,
#endif
    .n_inputs = sizeof input_ports / sizeof *input_ports,
    .inputs = input_ports,
    .n_outputs = sizeof output_ports / sizeof *output_ports,
    .outputs = output_ports,
    .n_parameters = sizeof parameter_list / sizeof *parameter_list,
    .parameters = parameter_list,
#ifndef HIDDEN_STATES
    .n_double_states = DECLARED_DOUBLES,
#endif
};

#ifdef HIDDEN_STATES
static memory hidden;
#endif

static memory *memory_of(const tb958_instance *instance)
{
#ifdef HIDDEN_STATES
    (void)instance;
    return &hidden;
#else
    return (memory *)instance->double_states;
#endif
}

/* Power-invariant space vector of three phase quantities, sqrt(3/2) of the phase peak. */
static void to_alpha_beta(const port abc[3], double unit, double *alpha, double *beta)
{
    const double scale = sqrt(2.0 / 3.0) * unit;
    *alpha = scale * (abc[0] - 0.5 * (abc[1] + abc[2]));
    *beta = scale * 0.8660254037844386 * (abc[1] - abc[2]);
}

static void to_abc(double alpha, double beta, double abc[3])
{
    const double scale = sqrt(2.0 / 3.0);
    abc[0] = scale * alpha;
    abc[1] = scale * (-0.5 * alpha + 0.8660254037844386 * beta);
    abc[2] = scale * (-0.5 * alpha - 0.8660254037844386 * beta);
}

/* The parabola through now, one and two samples ago, `lead` samples ahead. */
static double ahead(double lead, double now, const double past[2])
{
    return now + lead * (1.5 * now - 2.0 * past[0] + 0.5 * past[1]) + 0.5 * lead * lead * (now - 2.0 * past[0] + past[1]);
}

static void remember(double past[2], double now)
{
    past[1] = past[0];
    past[0] = now;
}

/* Start where the controls would stand if the outputs already were right. */
static void start(memory *m, const inputs *u, const outputs *y, const parameters *p)
{
    double v_re, v_im, i_re, i_im, c_re, c_im;
    to_alpha_beta(u->v_abc, v_unit, &v_re, &v_im);
    to_alpha_beta(u->i_abc, i_unit, &i_re, &i_im);
    const double v_dc = dc_unit * u->v_dc;
    to_alpha_beta(y->v_conv_abc, MODULATES ? 0.5 * v_dc : 1.0, &c_re, &c_im);
    memset(m, 0, sizeof *m);
    m->theta = atan2(v_im, v_re);
    double c = cos(m->theta), s = sin(m->theta);
    double i_d = c * i_re + s * i_im, i_q = c * i_im - s * i_re;
    m->xi_dc = i_d;
    m->xi_d = c * c_re + s * c_im + p->k_rd * i_q;
    m->xi_q = c * c_im - s * c_re - p->k_rd * i_d;
    m->i_d[0] = m->i_d[1] = i_d;
    m->i_q[0] = m->i_q[1] = i_q;
    m->v_dc[0] = m->v_dc[1] = v_dc;
    for (int k = 0; k < 3; k++)
        m->held[k] = y->v_conv_abc[k];
    m->started = 1.0;
}

static void control(memory *m, const inputs *u, outputs *y, const parameters *p)
{
    const double v_dc = dc_unit * u->v_dc, v_dc_ref = dc_unit * u->v_dc_ref;
    double v_re, v_im, i_re, i_im;
    to_alpha_beta(u->v_abc, v_unit, &v_re, &v_im);
    to_alpha_beta(u->i_abc, i_unit, &i_re, &i_im);
    double c = cos(m->theta), s = sin(m->theta);
    double v_q = c * v_im - s * v_re, i_d = c * i_re + s * i_im, i_q = c * i_im - s * i_re;

    /* What is measured, where the output will act, and (PLL) one sample ahead. */
    double lead = p->lead, more = T * (lead - 0.5);
    double v_q_mid = ahead(0.5, v_q, m->v_q);
    double i_d_there = ahead(lead, i_d, m->i_d), i_q_there = ahead(lead, i_q, m->i_q);
    double v_dc_there = ahead(lead, v_dc, m->v_dc);
    remember(m->v_q, v_q);
    remember(m->i_d, i_d);
    remember(m->i_q, i_q);
    remember(m->v_dc, v_dc);

    /* PLL: its integrator moves on to the middle of the interval, its angle to the next sample. */
    m->x_pll += T * p->k_pi * v_q;
    double speed = W1 + p->k_pp * v_q_mid + m->x_pll;
    double angle = m->theta + lead * T * speed;
    m->theta = remainder(m->theta + T * speed, 2.0 * 3.14159265358979323846);

    /* DC voltage; the integrator is held back while the reference is limited. */
    double error_dc = v_dc - v_dc_ref, xi_dc_before = m->xi_dc;
    m->xi_dc += T * p->k_dci * error_dc;
    double wanted = p->k_dcp * (v_dc_there - v_dc_ref) + m->xi_dc + more * p->k_dci * error_dc;
    double i_d_ref = fmin(fmax(wanted, -p->i_limit), p->i_limit);
    double i_d_ref_now = p->k_dcp * error_dc + 0.5 * (xi_dc_before + m->xi_dc);
    i_d_ref_now = fmin(fmax(i_d_ref_now, -p->i_limit), p->i_limit);
    if (p->k_dcp > 0.0)
        m->xi_dc += T * p->k_dci / p->k_dcp * (i_d_ref - wanted);

    /* Current; the converter gives v_dc / sqrt(2) at most. */
    double slope_d = p->k_i * (i_d_ref_now - i_d), slope_q = -p->k_i * i_q;
    m->xi_d += T * slope_d;
    m->xi_q += T * slope_q;
    double d = p->k_p * (i_d_ref - i_d_there) + m->xi_d + more * slope_d - p->k_rd * i_q_there;
    double q = -p->k_p * i_q_there + m->xi_q + more * slope_q + p->k_rd * i_d_there;
    double size = sqrt(d * d + q * q), limit = v_dc * 0.70710678118654752;
    double share = size > limit ? limit / size : 1.0;
    if (p->k_p > 0.0) {
        m->xi_d += T * p->k_i / p->k_p * (share - 1.0) * d;
        m->xi_q += T * p->k_i / p->k_p * (share - 1.0) * q;
    }
    c = share * cos(angle), s = share * sin(angle);
    double command[3];
    to_abc(c * d - s * q, s * d + c * q, command);
    if (MODULATES)
        for (int k = 0; k < 3; k++)
            command[k] /= 0.5 * v_dc;
    for (int k = 0; k < 3; k++) {
        y->v_conv_abc[k] = p->delay ? m->held[k] : command[k];
        m->held[k] = command[k];
    }
    y->limited = share < 1.0 || i_d_ref != wanted;
    y->angle = m->theta;
}

TB958_EXPORT const tb958_info *Model_GetInfo(void)
{
    return &info;
}

#ifndef BARE
TB958_EXPORT int32_t Model_FirstCall(tb958_instance *instance)
{
    (void)instance;
    return TB958_OK;
}

TB958_EXPORT int32_t Model_CheckParameters(tb958_instance *instance)
{
    const parameters *p = instance->parameters;
    if (p->delay && p->lead < 1.0) {
        instance->general_message = "Delay is on, but Lead does not make up for it";
        return TB958_MESSAGE;
    }
    if (p->k_i > 0.0 && p->k_p == 0.0) {
        instance->error_message = "Ki without Kp has no limit against wind-up";
        return TB958_ERROR;
    }
    return TB958_OK;
}

TB958_EXPORT int32_t Model_Initialize(tb958_instance *instance)
{
    start(memory_of(instance), instance->inputs, instance->outputs, instance->parameters);
    return TB958_OK;
}

TB958_EXPORT int32_t Model_Terminate(tb958_instance *instance)
{
    (void)instance;
    return TB958_OK;
}
#endif

/* -DWORK=n: so many operations besides, one after the other, as a larger controller has. */
static void work(double x)
{
#ifdef WORK
    for (int k = 0; k < WORK; k++)
        x = 0.5 * x + 1.0;
    __asm__ volatile("" : : "m"(x)); /* what nobody uses is computed all the same */
#endif
    (void)x;
}

TB958_EXPORT int32_t Model_Outputs(tb958_instance *instance)
{
    memory *m = memory_of(instance);
    const parameters *p = instance->parameters;
    count_a_step();
    work(((const inputs *)instance->inputs)->v_dc);
    if (m->started == 0.0)
        start(m, instance->inputs, instance->outputs, p);
    control(m, instance->inputs, instance->outputs, p);
    return instance->time_s >= p->fault_time ? fault(instance) : TB958_OK;
}
