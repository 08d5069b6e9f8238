/*
 * The 1-DoF arm in closed loop in plain C99: the peer that the arm's kernel is timed against.
 *
 *     cc -O3 -std=c99 -shared -fPIC arm1.c -o arm1.so -lm
 *
 * RK4 with steps of 1 ms, split exactly at each valve edge. The model is the printed one (gauge gas law, PWM 50 Hz
 * with a dead zone of 0.01); inside, everything is SI and pressures are gauge pressures in Pa.
 * Equation numbers: S.N. van den Brink, DCT 2007.002.
 */

#include <math.h>
#include <stdint.h>

/* The right-hand side in line in all four stages is a quarter faster; left to itself the compiler calls it. */
#if defined(__GNUC__)
#define IN_LINE static inline __attribute__((always_inline))
#else
#define IN_LINE static inline
#endif

#define PI 3.14159265358979323846
#define SQRT2 1.41421356237309504880

/* ---- pneumatics ---- */
#define BAR 1e5
#define P_ATM 1.01325e5
#define P_SUPPLY 1e5
#define GAS_T (287.0 * 293.0)     /* R_s T [J/kg] */
#define V_CAPACITY 0.01           /* [m3] */
#define RADIUS_IN 0.40e-3
#define RADIUS_SPLIT 0.52e-3
#define RADIUS_OUT 0.72e-3

/* ---- muscle ---- */
#define FIBRE 0.1274              /* L [m]; the fibre is 2 L long */
#define TURNS 1.25
#define D1 0.025
#define S1 0.117                  /* [m] */
#define S2 (0.232 * BAR)
#define STIFF_B (-3.97 * BAR)
#define K0 (-0.442)
#define K1 5.06
#define K2 (-12.80)
#define C0 0.82
#define C1 0.85
#define DAMP0 40.0
#define DAMP1 (1.94 / BAR)
#define FITTING 0.140

/* ---- body 2 ---- */
#define ARM_X (0.4533 - 0.1233)   /* l11x - lAB */
#define ARM_YA (0.0263 - 0.076)   /* l11y - l1A */
#define ARM_YB (0.0263 + 0.024)   /* l11y + l1B */
#define LEVER_A (0.176 - 0.142)   /* l12 - l2A */
#define LEVER_B (0.176 - 0.210)   /* l12 - l2B */
#define MASS 0.533
#define L12 0.176
#define INERTIA (MASS * L12 * L12 + 0.00570)
#define WEIGHT (MASS * 9.81 * L12)
#define THETA_MAX (45.0 * PI / 180.0)

/* ---- controller, PWM, sensors ---- */
#define TICK 1e-3
#define TICKS_PER_PERIOD 20
#define PERIOD 0.02
#define DEAD_ZONE 0.01
#define EDGE_EPS 1e-12            /* [s] an edge this close to a tick's end lies on it */
#define NOISE_THETA (0.02 * PI / 180.0)
#define NOISE_P 1e2
#define LSB_THETA (270.0 * PI / 180.0 / 4096.0)
#define LSB_P (2.0 * BAR / 4096.0)
#define MAX_SECTIONS 16

/*
 * A throttle's flow times R_s T [Pa m3/s] is gain(r) sign(p1 - p2) sqrt(|p1 - p2| (p1 + p2 + 2 p_atm)),
 * where gain(r) = R_s T beta / sqrt(2 R_s T). The compiler folds it.
 */
#define GAIN(r) (0.59 * SQRT2 * PI * (r) * (r) * sqrt(GAS_T / 2.0))

IN_LINE double throttle(double gain, double p1, double p2)
{
    const double dp = p1 - p2;
    const double q = gain * sqrt(fabs(dp) * (p1 + p2 + 2.0 * P_ATM));
    return dp < 0.0 ? -q : q;
}

/* Torque of one muscle on the joint [N m]; *dp becomes its pressure's rate. `inflow` is R_s T (q_in - q_out). */
IN_LINE double muscle(double lever, double y, double sine, double cosine, double w, double p, double inflow,
                      double *dp)
{
    /* |f|^2 = (x - r sin)^2 + (y + r cos)^2 */
    const double f =
        sqrt(ARM_X * ARM_X + y * y + lever * lever + 2.0 * lever * (y * cosine - ARM_X * sine));
    const double arm = lever * (y * sine + ARM_X * cosine) / f; /* -dh/dtheta */
    const double h = f - FITTING;
    const double dh = -arm * w;

    /* V = h (3 D1^2 + 4 D1 d2 + 8 d2^2) pi/60 with d2 = root/(n pi), as a polynomial in h and root */
    const double v0 = PI / 60.0 * 3.0 * D1 * D1;
    const double v1 = PI / 60.0 * 4.0 * D1 / (TURNS * PI);
    const double v2 = PI / 60.0 * 8.0 / (TURNS * PI * TURNS * PI);
    const double square = 4.0 * FIBRE * FIBRE - h * h;
    const double root = sqrt(square);
    const double area = v0 + v1 * root + v2 * square;
    const double root_dv_dh = area * root - h * h * (v1 + 2.0 * v2 * root); /* root * dV/dh: one division less */
    *dp = (inflow * root - p * root_dv_dh * dh) / (area * h * root);

    const double stretch = h - 2.0 * FIBRE + S1 * p / (S2 + p);
    const double k = STIFF_B * C0 * K0 + p * K0 + h * (STIFF_B * C1 * K1 + p * K1 + h * ((STIFF_B + p) * K2));
    return arm * (k * stretch + (DAMP0 + DAMP1 * p) * dh);
}

/* x = p_c, p_a, p_b, theta, w. An out-valve overrules the in-valve of its muscle. */
IN_LINE void rhs(const double *x, int in_a, int in_b, int out_a, int out_b, double *dx)
{
    const double p_c = x[0], p_a = x[1], p_b = x[2], w = x[4];
    double flow_a = 0.0, flow_b = 0.0; /* R_s T times the flow into the muscle */
    double flow_c = throttle(GAIN(RADIUS_IN), P_SUPPLY, p_c);

    if (in_a && in_b) { /* (3.34): the larger difference drives, the flow is shared in proportion */
        const double d_a = p_c - p_a, d_b = p_c - p_b, sum = fabs(d_a) + fabs(d_b);
        if (sum > 0.0) {
            const double q = fabs(throttle(GAIN(RADIUS_SPLIT), p_c, fabs(d_a) > fabs(d_b) ? p_a : p_b)) / sum;
            flow_a = q * d_a;
            flow_b = q * d_b;
        }
    } else if (in_a) {
        flow_a = throttle(GAIN(RADIUS_SPLIT), p_c, p_a);
    } else if (in_b) {
        flow_b = throttle(GAIN(RADIUS_SPLIT), p_c, p_b);
    }
    flow_c -= flow_a + flow_b;
    if (out_a)
        flow_a -= throttle(GAIN(RADIUS_OUT), p_a, 0.0);
    if (out_b)
        flow_b -= throttle(GAIN(RADIUS_OUT), p_b, 0.0);

    const double sine = sin(x[3]), cosine = cos(x[3]);
    const double torque = muscle(LEVER_A, ARM_YA, sine, cosine, w, p_a, flow_a, &dx[1])
                        + muscle(LEVER_B, ARM_YB, sine, cosine, w, p_b, flow_b, &dx[2]);
    dx[0] = flow_c * (1.0 / V_CAPACITY);
    dx[3] = w;
    dx[4] = (torque + WEIGHT * sine) * (1.0 / INERTIA); /* (F.67) */
}

/* One RK4 step of length h; the valves stand still. */
static void rk4(double *x, double h, int in_a, int in_b, int out_a, int out_b)
{
    double k1[5], k2[5], k3[5], k4[5], y[5];

    rhs(x, in_a, in_b, out_a, out_b, k1);
    for (int i = 0; i < 5; i++)
        y[i] = x[i] + 0.5 * h * k1[i];
    rhs(y, in_a, in_b, out_a, out_b, k2);
    for (int i = 0; i < 5; i++)
        y[i] = x[i] + 0.5 * h * k2[i];
    rhs(y, in_a, in_b, out_a, out_b, k3);
    for (int i = 0; i < 5; i++)
        y[i] = x[i] + h * k3[i];
    rhs(y, in_a, in_b, out_a, out_b, k4);
    for (int i = 0; i < 5; i++)
        x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
}

/* A PWM pulse: which valve, and when it closes, in seconds from the period's start. */
typedef struct {
    int fills;
    double end;
} pulse;

static pulse start_pulse(double u)
{
    const double size = fabs(u);
    pulse p = {u > 0.0, size * PERIOD};
    if (!(size > DEAD_ZONE))
        p.end = 0.0;
    else if (size > 1.0 - DEAD_ZONE)
        p.end = PERIOD;
    return p;
}

/* One tick that begins `since` seconds after the period's start, split where a valve closes. */
static void integrate_tick(double *x, double since, pulse a, pulse b)
{
    const double end_a = a.end - since, end_b = b.end - since;
    double t = 0.0;

    while (t < TICK) {
        const int open_a = end_a > t + EDGE_EPS, open_b = end_b > t + EDGE_EPS;
        double next = TICK;
        if (open_a && end_a < next - EDGE_EPS)
            next = end_a;
        if (open_b && end_b < next - EDGE_EPS)
            next = end_b;
        rk4(x, next - t, open_a && a.fills, open_b && b.fills, open_a && !a.fills, open_b && !b.fills);
        t = next;
    }
}

/* Gaussian noise: multiply-with-carry, then Box-Muller with the second value kept. */
typedef struct {
    uint64_t x;
    int has_spare;
    double spare;
} generator;

static double uniform(generator *g)
{
    g->x = UINT64_C(1791398085) * (g->x & UINT64_C(0xffffffff)) + (g->x >> 32);
    return ((double)(uint32_t)g->x + 0.5) * (1.0 / 4294967296.0);
}

static double gauss(generator *g)
{
    if (g->has_spare) {
        g->has_spare = 0;
        return g->spare;
    }
    const double radius = sqrt(-2.0 * log(uniform(g)));
    const double angle = 2.0 * PI * uniform(g);
    g->spare = radius * sin(angle);
    g->has_spare = 1;
    return radius * cos(angle);
}

/* To the nearest multiple of `lsb`; halves away from zero. */
static double convert(double value, double lsb)
{
    const double v = value * (1.0 / lsb);
    return lsb * (double)(int)(v < 0.0 ? v - 0.5 : v + 0.5);
}

/* Sections in a row, direct form II transposed; coefficients b0, b1, b2, a1, a2 and two states a section. */
static double cascade(int n, const double *c, double *s, double value)
{
    for (int i = 0; i < n; i++, c += 5, s += 2) {
        const double y = c[0] * value + s[0];
        s[0] = c[1] * value - c[3] * y + s[1];
        s[1] = c[2] * value - c[4] * y;
        value = y;
    }
    return value;
}

/* Sections of a loop without the unity sections that pad it. */
static int count_sections(int n, const double *c)
{
    while (n > 0 && c[5 * n - 5] == 1.0 && c[5 * n - 4] == 0.0 && c[5 * n - 3] == 0.0 && c[5 * n - 2] == 0.0
           && c[5 * n - 1] == 0.0)
        n--;
    return n;
}

/* Right-hand side; x as in arm1_run, valves = in_a, in_b, out_a, out_b (0 or 1), dx in Pa/s, rad/s, rad/s2. */
void arm1_rhs(const double *x, const double *valves, double *dx)
{
    const int out_a = valves[2] != 0.0, out_b = valves[3] != 0.0;
    rhs(x, valves[0] != 0.0 && !out_a, valves[1] != 0.0 && !out_b, out_a, out_b, dx);
}

/*
 * n ticks of 1 ms. Order inside a tick: measure, control, log, start a PWM period if one is due, integrate.
 *
 * r         n x 2: theta2 [rad], p_a + p_b [Pa]
 * inj       n x 2: added at the controllers' inputs, whose units are rad and bar
 * biquads   2 x n_sections x 5 (b0, b1, b2, a1, a2), loops theta2 and p_ab, for errors in rad and bar
 * x         p_c, p_a, p_b [Pa gauge], theta [rad], w [rad/s]; the start, and on return the end
 * seed      the generator's 64-bit state, not 0; used with noise_on, which switches noise and converters
 * out       n x 7: theta2 [rad], p_a, p_b [Pa] as measured, z_theta2, z_p, u_a, u_b [V]
 *
 * Controllers start from rest. Returns 0; or -1 for n_sections out of range; or the count of ticks done, where
 * the arm left |theta2| < 45 deg, beyond which the model says nothing (the rows from there on are not written).
 */
int arm1_run(int n, const double *r, const double *inj, const double *biquads, int n_sections, double *x,
             long long seed, int noise_on, double *out)
{
    if (n_sections < 0 || n_sections > MAX_SECTIONS)
        return -1;

    const double *c_theta = biquads, *c_p = biquads + 5 * n_sections;
    const int n_theta = count_sections(n_sections, c_theta), n_p = count_sections(n_sections, c_p);
    double s_theta[2 * MAX_SECTIONS] = {0.0}, s_p[2 * MAX_SECTIONS] = {0.0};
    generator noise = {seed ? (uint64_t)seed : 1, 0, 0.0};
    pulse a = {0, 0.0}, b = {0, 0.0};
    double state[5] = {x[0], x[1], x[2], x[3], x[4]};
    int phase = 0, done = 0;

    for (int k = 0; k < n; k++) {
        double theta = state[3], p_a = state[1], p_b = state[2];
        if (noise_on) {
            theta = convert(theta + NOISE_THETA * gauss(&noise), LSB_THETA);
            p_a = convert(p_a + NOISE_P * gauss(&noise), LSB_P);
            p_b = convert(p_b + NOISE_P * gauss(&noise), LSB_P);
        }

        const double z_theta = cascade(n_theta, c_theta, s_theta, r[2 * k] - theta + inj[2 * k]);
        const double z_p = cascade(n_p, c_p, s_p, (r[2 * k + 1] - (p_a + p_b)) * (1.0 / BAR) + inj[2 * k + 1]);
        const double u_a = z_theta + z_p, u_b = -z_theta + z_p;

        double *row = out + 7 * (long)k;
        row[0] = theta;
        row[1] = p_a;
        row[2] = p_b;
        row[3] = z_theta;
        row[4] = z_p;
        row[5] = u_a;
        row[6] = u_b;

        if (phase == 0) {
            a = start_pulse(u_a);
            b = start_pulse(u_b);
        }
        integrate_tick(state, phase * TICK, a, b);
        if (++phase == TICKS_PER_PERIOD)
            phase = 0;

        if (!(fabs(state[3]) < THETA_MAX)) {
            done = k + 1;
            break;
        }
    }

    for (int i = 0; i < 5; i++)
        x[i] = state[i];
    return done;
}
