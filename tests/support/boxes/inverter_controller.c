/* Controls of an inverter as TB 958 libraries, with the port lists of public real-code controllers.

   default   follows the grid: three phases one by one in kV and kA, references in pu, modulation index out
   FORMING   droop: references in MW and Mvar, bridge voltage in kV out
   BATTERY   the same droop behind arrays in V and A, with an enable, a gate and hidden statics, every 200 us

   The laws are our own and plain: PLL and current control; droop behind the choke, with a resistance that acts
   on what changes. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "tb958.h"

#define PI 3.14159265358979323846

#ifdef BATTERY
#define T 200e-6
#define FORMING
#else
#define T 10e-6
#endif

#if defined BATTERY
typedef struct {
    double v_ac[3], i_L[3], v_dc;
    int32_t enable;
    double P_request, Q_request, P_lim_high, P_lim_low;
} inputs;
typedef struct {
    double v_bridge[3];
    int32_t pwm_enable;
} outputs;
#elif defined FORMING
typedef struct {
    double Va, Vb, Vc, Ia, Ib, Ic, IaL1, IbL1, IcL1, Pref, Qref, Vref;
} inputs;
typedef struct {
    double Ea, Eb, Ec, Idref, Id, Iqref, Iq, Vd, Vq, Freq_pll, Pout, Qout;
} outputs;
#else
typedef struct {
    double Vta, Vtb, Vtc, I1a, I1b, I1c, I2a, I2b, I2c, Idc, VdcMPPT, Pref, Qref, Vdc_meas, Vref;
} inputs;
typedef struct {
    double m_a, m_b, m_c, FreqPLL, Id1, Iq1, Id2, Iq2, Vtd1, Vtq1, Vtd2, Vtq2, FRT_Flag, Pout, Qout;
} outputs;
#endif

typedef struct {
    double f1, s_base, u_base, k_pp, k_pi, k_p, k_i, droop, k_q, w_filter, r_transient, start_up;
} parameters;

typedef struct {
    double started, theta, x_pll, xi_d, xi_q, p, q, i_d, i_q;
} memory;

#define N_DOUBLES ((int)(sizeof(memory) / sizeof(double)))

#define IN(name, unit) {name, "input", unit, TB958_REAL64, 1}
static const tb958_signal input_ports[] = {
#if defined BATTERY
    {"v_ac", "capacitor voltage", "V", TB958_REAL64, 3}, {"i_L", "choke current", "A", TB958_REAL64, 3},
    IN("v_dc", "V"), {"enable", "run", "", TB958_INT32, 1}, IN("P_request", "W"), IN("Q_request", "var"),
    IN("P_lim_high", "W"), IN("P_lim_low", "W"),
#elif defined FORMING
    IN("Va", "kV"), IN("Vb", "kV"), IN("Vc", "kV"), IN("Ia", "kA"), IN("Ib", "kA"), IN("Ic", "kA"),
    IN("IaL1", "kA"), IN("IbL1", "kA"), IN("IcL1", "kA"), IN("Pref", "MW"), IN("Qref", "Mvar"), IN("Vref", "pu"),
#else
    IN("Vta", "kV"), IN("Vtb", "kV"), IN("Vtc", "kV"), IN("I1a", "kA"), IN("I1b", "kA"), IN("I1c", "kA"),
    IN("I2a", "kA"), IN("I2b", "kA"), IN("I2c", "kA"), IN("Idc", "kA"), IN("VdcMPPT", "kV"), IN("Pref", "pu"),
    IN("Qref", "pu"), IN("Vdc_meas", "kV"), IN("Vref", "pu"),
#endif
};

#define OUT(name, unit) {name, "output", unit, TB958_REAL64, 1}
static const tb958_signal output_ports[] = {
#if defined BATTERY
    {"v_bridge", "bridge voltage", "V", TB958_REAL64, 3}, {"pwm_enable", "gate", "", TB958_INT32, 1},
#elif defined FORMING
    OUT("Ea", "kV"), OUT("Eb", "kV"), OUT("Ec", "kV"), OUT("Idref", "pu"), OUT("Id", "pu"), OUT("Iqref", "pu"),
    OUT("Iq", "pu"), OUT("Vd", "pu"), OUT("Vq", "pu"), OUT("Freq_pll", "Hz"), OUT("Pout", "MW"), OUT("Qout", "Mvar"),
#else
    OUT("m_a", ""), OUT("m_b", ""), OUT("m_c", ""), OUT("FreqPLL", "Hz"), OUT("Id1", "pu"), OUT("Iq1", "pu"),
    OUT("Id2", "pu"), OUT("Iq2", "pu"), OUT("Vtd1", "pu"), OUT("Vtq1", "pu"), OUT("Vtd2", "pu"), OUT("Vtq2", "pu"),
    OUT("FRT_Flag", ""), OUT("Pout", "pu"), OUT("Qout", "pu"),
#endif
};

#define REAL(name, unit, value) {name, "control", name, unit, TB958_REAL64, 0, {.real64 = value}, {.real64 = 0.0}, {.real64 = 1e9}}
static const tb958_parameter parameter_list[] = {
    REAL("F1", "Hz", 60.0), REAL("Sbase", "VA", 1e6), REAL("Ubase", "V", 600.0),
    REAL("Kpp", "rad/s/V", 0.2), REAL("Kpi", "rad/s2/V", 7.0), REAL("Kp", "ohm", 0.1), REAL("Ki", "ohm/s", 10.0),
    REAL("Droop", "pu", 0.02), REAL("Kq", "pu", 0.05), REAL("Wfilter", "rad/s", 60.0),
    REAL("Rtransient", "ohm", 0.03), REAL("StartUp", "s", 0.0),
};

static const tb958_info info = {
    .interface_version = {1, 1, 0, 0},
    .name = "InverterController",
    .version = "1.0",
    .description = "Controls of an inverter",
    .general = "stand-in with the ports of public controllers",
    .sample_time_s = T,
    .emt_rms = 1,
    .n_inputs = sizeof input_ports / sizeof *input_ports,
    .inputs = input_ports,
    .n_outputs = sizeof output_ports / sizeof *output_ports,
    .outputs = output_ports,
    .n_parameters = sizeof parameter_list / sizeof *parameter_list,
    .parameters = parameter_list,
#ifndef BATTERY
    .n_double_states = N_DOUBLES,
#endif
};

#ifdef BATTERY
static memory hidden;
#endif

static memory *memory_of(const tb958_instance *instance)
{
#ifdef BATTERY
    (void)instance;
    return &hidden;
#else
    return (memory *)instance->double_states;
#endif
}

static void to_vector(double a, double b, double c, double unit, double *re, double *im)
{
    *re = unit * 2.0 / 3.0 * (a - 0.5 * (b + c));
    *im = unit * 0.57735026918962576 * (b - c);
}

static void to_phases(double re, double im, double abc[3])
{
    abc[0] = re;
    abc[1] = -0.5 * re + 0.8660254037844386 * im;
    abc[2] = -0.5 * re - 0.8660254037844386 * im;
}

TB958_EXPORT const tb958_info *Model_GetInfo(void) { return &info; }
TB958_EXPORT int32_t Model_FirstCall(tb958_instance *instance) { (void)instance; return TB958_OK; }
TB958_EXPORT int32_t Model_CheckParameters(tb958_instance *instance) { (void)instance; return TB958_OK; }
TB958_EXPORT int32_t Model_Initialize(tb958_instance *instance)
{
    memset(memory_of(instance), 0, sizeof(memory));
    return TB958_OK;
}
TB958_EXPORT int32_t Model_Terminate(tb958_instance *instance) { (void)instance; return TB958_OK; }

TB958_EXPORT int32_t Model_Outputs(tb958_instance *instance)
{
    memory *m = memory_of(instance);
    const inputs *u = instance->inputs;
    outputs *y = instance->outputs;
    const parameters *p = instance->parameters;
    const double w1 = 2.0 * PI * p->f1, peak = sqrt(2.0 / 3.0) * p->u_base;
    double v_re, v_im, i_re, i_im, out[3];
#if defined BATTERY
    to_vector(u->v_ac[0], u->v_ac[1], u->v_ac[2], 1.0, &v_re, &v_im);
    to_vector(u->i_L[0], u->i_L[1], u->i_L[2], 1.0, &i_re, &i_im);
    const double p_ref = fmin(fmax(u->P_request, u->P_lim_low), u->P_lim_high), q_ref = u->Q_request, v_ref = peak;
#elif defined FORMING
    to_vector(u->Va, u->Vb, u->Vc, 1e3, &v_re, &v_im);
    to_vector(u->IaL1, u->IbL1, u->IcL1, 1e3, &i_re, &i_im);
    const double p_ref = 1e6 * u->Pref, q_ref = 1e6 * u->Qref, v_ref = u->Vref * peak;
#else
    to_vector(u->Vta, u->Vtb, u->Vtc, 1e3, &v_re, &v_im);
    to_vector(u->I1a, u->I1b, u->I1c, 1e3, &i_re, &i_im);
#endif
    if (m->started == 0.0) {
        m->started = 1.0;
        m->theta = atan2(v_im, v_re);
    }
    const double c = cos(m->theta), s = sin(m->theta);
    const double v_d = c * v_re + s * v_im, v_q = c * v_im - s * v_re, i_d = c * i_re + s * i_im, i_q = c * i_im - s * i_re;
    const double p_now = 1.5 * (v_d * i_d + v_q * i_q), q_now = 1.5 * (v_q * i_d - v_d * i_q);
#ifdef FORMING
    m->p += T * p->w_filter * (p_now - m->p);
    m->q += T * p->w_filter * (q_now - m->q);
    m->i_d += T * p->w_filter * (i_d - m->i_d);
    m->i_q += T * p->w_filter * (i_q - m->i_q);
    const double size = v_ref + p->k_q * peak * (q_ref - m->q) / p->s_base;
    const double d = size - p->r_transient * (i_d - m->i_d), q = -p->r_transient * (i_q - m->i_q);
    const double speed = w1 * (1.0 + p->droop * (p_ref - m->p) / p->s_base);
    const double angle = m->theta + 0.5 * T * speed;
    to_phases(cos(angle) * d - sin(angle) * q, sin(angle) * d + cos(angle) * q, out);
    m->theta = remainder(m->theta + T * speed, 2.0 * PI);
#ifdef BATTERY
    memcpy(y->v_bridge, out, sizeof out);
    y->pwm_enable = u->enable;
#else
    y->Ea = 1e-3 * out[0], y->Eb = 1e-3 * out[1], y->Ec = 1e-3 * out[2];
    y->Freq_pll = speed / (2.0 * PI), y->Pout = 1e-6 * m->p, y->Qout = 1e-6 * m->q;
#endif
#else
    const double amount = instance->time_s < p->start_up ? 0.0 : 1.0;
    const double i_d_ref = amount * u->Pref * p->s_base / (1.5 * peak), i_q_ref = -amount * u->Qref * p->s_base / (1.5 * peak);
    m->x_pll += T * p->k_pi * v_q;
    const double speed = w1 + p->k_pp * v_q + m->x_pll, angle = m->theta + 0.5 * T * speed;
    m->xi_d += T * p->k_i * (i_d_ref - i_d);
    m->xi_q += T * p->k_i * (i_q_ref - i_q);
    const double d = p->k_p * (i_d_ref - i_d) + m->xi_d + peak, q = p->k_p * (i_q_ref - i_q) + m->xi_q;
    const double half = 0.5e3 * u->Vdc_meas;
    to_phases((cos(angle) * d - sin(angle) * q) / half, (sin(angle) * d + cos(angle) * q) / half, out);
    m->theta = remainder(m->theta + T * speed, 2.0 * PI);
    y->m_a = out[0], y->m_b = out[1], y->m_c = out[2];
    y->FreqPLL = speed / (2.0 * PI), y->Pout = p_now / p->s_base, y->Qout = q_now / p->s_base;
#endif
    return TB958_OK;
}
