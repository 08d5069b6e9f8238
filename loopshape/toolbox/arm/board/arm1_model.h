/*
 * The 1-DoF arm in plain C, operation for operation as loopshape/toolbox/arm/dynamics/model.py and closed_loop.py have it: capacity,
 * splitter, two muscles, one body; RK4 split exactly where a valve closes. SI, gauge pressures in Pa. The constants come from
 * Python (plants/arm/parameters.constants): the printed model with other numbers, tilt, payload, leaks and dead volumes;
 * effects that remember or delay are not in here.
 */
#ifndef LOOPSHAPE_ARM1_MODEL_H
#define LOOPSHAPE_ARM1_MODEL_H

#include <math.h>
#include <stdint.h>

enum {
    RT, BETA_IN, BETA_S, BETA_OUT, P_IN, P_ATM2, V_C, X, YA, YB, R_A, R_B, FITTING, INERTIA, GRAVITY, FOUR_L2, N_PI,
    D1_SQ3, D1_X4, TWO_L, S1, S2, BK0, BK1, BK2, K0, K1, K2, D0, D1, FACTOR_A, FACTOR_B, ABSOLUTE, EXPONENT,
    DEAD_A, DEAD_B, TWO_L_A, TWO_L_B, COMPRESSION, LEAK_A, LEAK_B, TILT_SINE, TILT_COSINE, CONSTANTS
};
enum { NOISE_ANGLE, NOISE_P, STEP_ANGLE, STEP_P, WIDEST, LOWEST, HIGHEST, SPAN_ANGLE, SPAN_P, SENSOR_CONSTANTS };

struct arm {
    double c[CONSTANTS], sensor[SENSOR_CONSTANTS];
    double x[5];               /* p_c, p_A, p_B, theta2, its velocity */
    double close_a, close_b;   /* s from the period's start */
    int fills_a, fills_b;      /* 1: in valve, -1: out valve, 0: neither */
    uint64_t noise;
    double spare;
    int has_spare;
};

static inline double arm_flow(const struct arm *m, double beta, double p1, double p2)
{
    const double drop = p1 - p2;
    return copysign(beta * sqrt((p1 + p2 + m->c[P_ATM2]) * fabs(drop)), drop);
}

/* Flows through the splitter into A and B (3.28-3.34). */
static inline void arm_supply(const struct arm *m, double p_c, double p_a, double p_b, int in_a, int in_b, double *q)
{
    q[0] = q[1] = 0.0;
    if (in_a && in_b) {
        const double drop_a = p_c - p_a, drop_b = p_c - p_b, total = fabs(drop_a) + fabs(drop_b);
        if (total == 0.0)
            return;
        const double p_s = fabs(drop_a) > fabs(drop_b) ? p_a : p_b;
        const double size = fabs(arm_flow(m, m->c[BETA_S], p_c, p_s)) / total;
        q[0] = size * drop_a;
        q[1] = size * drop_b;
    } else if (in_a) {
        q[0] = arm_flow(m, m->c[BETA_S], p_c, p_a);
    } else if (in_b) {
        q[1] = arm_flow(m, m->c[BETA_S], p_c, p_b);
    }
}

struct muscle {
    double pull, volume, slope;
};

/* Pull in N, volume in m3 and dV/dh in m2 of a muscle of length h (3.36-3.52, 4.5). */
static inline struct muscle arm_muscle(const double *c, double p, double h, double dh, double factor, double two_l)
{
    const double root = sqrt(c[FOUR_L2] - h * h), d2 = root / c[N_PI], area = c[D1_SQ3] + d2 * (c[D1_X4] + 8.0 * d2);
    const double bar = 1e-5 * p, nominal = two_l - c[S1] * bar / (c[S2] + bar);
    const double stiffness =
        (c[BK0] + bar * c[K0]) + h * ((c[BK1] + bar * c[K1]) + h * (c[BK2] + bar * c[K2]));
    struct muscle out;
    out.volume = 0.05235987755982988 * h * area;
    out.slope = 0.05235987755982988 * (area - h * (c[D1_X4] + 16.0 * d2) * h / (c[N_PI] * root));
    out.pull = factor * stiffness * (h - nominal) + (c[D0] + c[D1] * bar) * dh;
    return out;
}

/* Right-hand side; valves[] = 1 fills, -1 empties, 0 shut. */
static inline void arm_rhs(const struct arm *m, const double *x, int a, int b, double *dx)
{
    const double *c = m->c, sine = sin(x[3]), cosine = cos(x[3]), w = x[4];
    const double xa = c[X] - c[R_A] * sine, ya = c[YA] + c[R_A] * cosine;
    const double xb = c[X] - c[R_B] * sine, yb = c[YB] + c[R_B] * cosine;
    const double length_a = sqrt(xa * xa + ya * ya), length_b = sqrt(xb * xb + yb * yb);
    const double lever_a = c[R_A] * (c[YA] * sine + c[X] * cosine) / length_a;
    const double lever_b = c[R_B] * (c[YB] * sine + c[X] * cosine) / length_b;
    const double dh_a = -lever_a * w, dh_b = -lever_b * w;
    const struct muscle ma = arm_muscle(c, x[1], length_a - c[FITTING], dh_a, c[FACTOR_A], c[TWO_L_A]);
    const struct muscle mb = arm_muscle(c, x[2], length_b - c[FITTING], dh_b, c[FACTOR_B], c[TWO_L_B]);
    double q[2];

    arm_supply(m, x[0], x[1], x[2], a > 0, b > 0, q);
    const double drain = q[0] + q[1];
    if (a < 0)
        q[0] -= arm_flow(m, c[BETA_OUT], x[1], 0.0);
    if (b < 0)
        q[1] -= arm_flow(m, c[BETA_OUT], x[2], 0.0);
    if (c[LEAK_A] > 0.0)
        q[0] -= arm_flow(m, c[LEAK_A], x[1], 0.0);
    if (c[LEAK_B] > 0.0)
        q[1] -= arm_flow(m, c[LEAK_B], x[2], 0.0);
    dx[0] = c[RT] * (arm_flow(m, c[BETA_IN], c[P_IN], x[0]) - drain) / c[V_C];
    const double work_a = c[COMPRESSION] * (x[1] + c[ABSOLUTE]) * ma.slope * dh_a;
    const double work_b = c[COMPRESSION] * (x[2] + c[ABSOLUTE]) * mb.slope * dh_b;
    dx[1] = c[EXPONENT] * (c[RT] * q[0] - work_a) / (ma.volume + c[DEAD_A]);
    dx[2] = c[EXPONENT] * (c[RT] * q[1] - work_b) / (mb.volume + c[DEAD_B]);
    const double upright = sine * c[TILT_COSINE] + cosine * c[TILT_SINE];
    dx[3] = w;
    dx[4] = (c[GRAVITY] * upright + ma.pull * lever_a + mb.pull * lever_b) / c[INERTIA];
}

static inline void arm_rk4(struct arm *m, double h, int a, int b)
{
    double k1[5], k2[5], k3[5], k4[5], y[5];
    const double half = 0.5 * h, sixth = h / 6.0;

    arm_rhs(m, m->x, a, b, k1);
    for (int i = 0; i < 5; i++)
        y[i] = m->x[i] + half * k1[i];
    arm_rhs(m, y, a, b, k2);
    for (int i = 0; i < 5; i++)
        y[i] = m->x[i] + half * k2[i];
    arm_rhs(m, y, a, b, k3);
    for (int i = 0; i < 5; i++)
        y[i] = m->x[i] + h * k3[i];
    arm_rhs(m, y, a, b, k4);
    for (int i = 0; i < 5; i++)
        m->x[i] += sixth * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
}

/* From `start` to `end`, in s of the PWM period, split where a valve closes. */
static inline void arm_move(struct arm *m, double start, double end)
{
    double now = start;
    while (now < end) {
        double stop = end;
        if (m->close_a > now && m->close_a < stop)
            stop = m->close_a;
        if (m->close_b > now && m->close_b < stop)
            stop = m->close_b;
        const double middle = 0.5 * (now + stop);
        arm_rk4(m, stop - now, middle < m->close_a ? m->fills_a : 0, middle < m->close_b ? m->fills_b : 0);
        now = stop;
    }
}

static inline uint64_t arm_draw(uint64_t state)
{
    return UINT64_C(1791398085) * (state & UINT64_C(0xffffffff)) + (state >> 32);
}

/* Two standard normal values by Box and Muller, as kernels/noise.py draws them. */
static inline void arm_normal_pair(struct arm *m, double *first, double *second)
{
    m->noise = arm_draw(m->noise);
    const double radius = sqrt(-2.0 * log(((double)(uint32_t)m->noise + 0.5) / 4294967296.0));
    m->noise = arm_draw(m->noise);
    const double angle = 6.283185307179586 * (((double)(uint32_t)m->noise + 0.5) / 4294967296.0);
    *first = radius * cos(angle);
    *second = radius * sin(angle);
}

static inline double arm_converted(double value, double step, double low, double high)
{
    if (step == 0.0)
        return value;
    const double whole = step * nearbyint(value / step); /* halves to even, as Python's round */
    return whole < low ? low : whole > high ? high : whole;
}

/* theta2 in rad, p_A and p_B in bar as measured: with noise and converters. */
static inline void arm_sense(struct arm *m, double *out)
{
    const double *s = m->sensor;
    double theta = m->x[3], p_a = m->x[1], p_b = m->x[2], n1, n2, n3;

    if (s[NOISE_ANGLE] > 0.0 || s[NOISE_P] > 0.0) {
        arm_normal_pair(m, &n1, &n2);
        if (m->has_spare)
            n3 = m->spare;
        else
            arm_normal_pair(m, &n3, &m->spare);
        m->has_spare = !m->has_spare;
        theta += s[NOISE_ANGLE] * n1;
        p_a += s[NOISE_P] * n2;
        p_b += s[NOISE_P] * n3;
    }
    out[0] = arm_converted(theta, s[STEP_ANGLE], -s[SPAN_ANGLE], s[SPAN_ANGLE]);
    out[1] = 1e-5 * arm_converted(p_a, s[STEP_P], 0.0, s[SPAN_P]);
    out[2] = 1e-5 * arm_converted(p_b, s[STEP_P], 0.0, s[SPAN_P]);
}

static inline double arm_unbalance(const struct arm *m, double angle, double p_a_bar, double p_ab_bar)
{
    const double x[5] = {0.0, 1e5 * p_a_bar, 1e5 * (p_ab_bar - p_a_bar), angle, 0.0};
    double dx[5];
    arm_rhs(m, x, 0, 0, dx);
    return dx[4];
}

/* Pressure p_A in bar that holds the angle at p_AB = p_A + p_B, by bisection to rounding; nan where none does. */
static inline double arm_balance(const struct arm *m, double angle, double p_ab_bar)
{
    double low = 0.02, high = p_ab_bar - 0.02;

    if (!(high > low))
        return (double)NAN;
    const double at_low = arm_unbalance(m, angle, low, p_ab_bar);
    if (!(at_low * arm_unbalance(m, angle, high, p_ab_bar) <= 0.0))
        return (double)NAN;
    for (;;) {
        const double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high)
            return middle;
        if (arm_unbalance(m, angle, middle, p_ab_bar) * at_low > 0.0)
            low = middle;
        else
            high = middle;
    }
}

/* Why the state lies outside the model's range, or NULL. */
static inline const char *arm_left(const struct arm *m)
{
    const double *x = m->x, *s = m->sensor;
    if (!isfinite(x[0] + x[1] + x[2] + x[3] + x[4]))
        return "the state is no longer a number";
    if (fabs(x[3]) > s[WIDEST])
        return "the angle left the model's range";
    if (fmin(x[1], x[2]) < s[LOWEST] || fmax(x[1], x[2]) > s[HIGHEST])
        return "a muscle's pressure left the model's range";
    return 0;
}

#endif
