/*
 * The 2-DoF arm in closed loop in plain C99: the peer that the kernel of two joints is timed against.
 *
 *     cc -O3 -std=c99 -shared -fPIC arm2.c -o arm2.so -lm
 *
 * RK4 with steps of 1 ms, split exactly at each valve edge. The model is the printed one (gauge gas law, PWM 50 Hz
 * with a dead zone of 0.01) with the signs of ARM.md; inside, everything is SI and pressures are gauge pressures in Pa.
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

/* ---- bodies ---- */
#define G 9.81
#define ARM_X (0.4533 - 0.1233)   /* l11x - lAB */
#define ARM_YA (0.0263 - 0.076)   /* l11y - l1A */
#define ARM_YB (0.0263 + 0.024)   /* l11y + l1B */
#define LEVER_A (0.176 - 0.142)   /* l12 - l2A */
#define LEVER_B (0.176 - 0.210)   /* l12 - l2B */
#define L0 0.375
#define L01X 0.0667
#define L01Y 0.0137
#define L1X 0.520
#define L1Y 0.040
#define LSVX 0.110
#define LSVY 0.026
#define FOOT_C (-0.020)
#define FOOT_D 0.020
#define FOOT_S 0.170
#define LEVER_C (0.0667 - 0.035)  /* l01x - l1C */
#define LEVER_D (0.0667 - 0.105)
#define LEVER_S (0.0667 - 0.185)
#define SPRING 1000.0
#define SPRING_LENGTH 0.33943492
#define MASS_SV 0.80
#define MASS1 2.64
#define MASS2 0.533
#define L12 0.176
#define J1 0.0893
#define INERTIA2 (MASS2 * L12 * L12 + 0.00570)
#define INERTIA1 (MASS_SV * (LSVX * LSVX + LSVY * LSVY) + MASS1 * (L01X * L01X + L01Y * L01Y) + J1 \
                  + MASS2 * (L1X * L1X + L1Y * L1Y))
#define WEIGHT_X (G * (MASS_SV * LSVX + MASS1 * L01X + MASS2 * L1X))
#define WEIGHT_Y (G * (MASS_SV * LSVY + MASS1 * L01Y + MASS2 * L1Y))
#define WEIGHT2 (MASS2 * G * L12)
#define THETA1_MAX (25.0 * PI / 180.0)
#define THETA2_MAX (45.0 * PI / 180.0)
#define P_LOW (0.15 * BAR)
#define P_HIGH (1.2 * BAR)
#define STATES 9

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

/* Pull of one muscle of length h [N]; *dp becomes its pressure's rate. `inflow` is R_s T (q_in - q_out). */
IN_LINE double muscle(double h, double dh, double p, double inflow, double *dp)
{
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
    return k * stretch + (DAMP0 + DAMP1 * p) * dh;
}

/* Torque of muscle A or B on joint 2 [N m]. |f|^2 = (x - r sin)^2 + (y + r cos)^2 */
IN_LINE double upper(double lever, double y, double sine, double cosine, double w, double p, double inflow, double *dp)
{
    const double f =
        sqrt(ARM_X * ARM_X + y * y + lever * lever + 2.0 * lever * (y * cosine - ARM_X * sine));
    const double arm = lever * (y * sine + ARM_X * cosine) / f; /* -dh/dtheta2 */
    return arm * muscle(f - 0.140, -arm * w, p, inflow, dp);
}

/* Length of [foot + r cos, l0 + r sin], and its lever -dlength/dtheta1. */
IN_LINE double link(double lever, double foot, double sine, double cosine, double *arm)
{
    const double f = sqrt(foot * foot + L0 * L0 + lever * lever + 2.0 * lever * (L0 * sine + foot * cosine));
    *arm = lever * (foot * sine - L0 * cosine) / f;
    return f;
}

/* Torque of muscle C or D on joint 1 [N m]. */
IN_LINE double lower(double lever, double foot, double sine, double cosine, double w, double p, double inflow,
                     double *dp)
{
    double arm;
    const double f = link(lever, foot, sine, cosine, &arm);
    return arm * muscle(f - 0.180, -arm * w, p, inflow, dp);
}

IN_LINE double larger(double a, double b)
{
    return fabs(a) > fabs(b) ? a : b;
}

/* x = p_capacity, p_a .. p_d, theta1, theta2, w1, w2; v = 1 fills, -1 lets out, 0 shut, of A .. D. */
IN_LINE void rhs(const double *x, const int *v, double *dx)
{
    const double p = x[0], w1 = x[7], w2 = x[8];
    double flow[4] = {0.0, 0.0, 0.0, 0.0}; /* R_s T times the flow into the muscle */
    double flow_c = throttle(GAIN(RADIUS_IN), P_SUPPLY, p);

    if (v[0] > 0 || v[1] > 0 || v[2] > 0 || v[3] > 0) { /* (D.11-D.23): the largest difference drives, all share */
        double most = 0.0, sum = 0.0;
        for (int i = 0; i < 4; i++) {
            flow[i] = v[i] > 0 ? p - x[1 + i] : 0.0;
            most = larger(most, flow[i]);
            sum += fabs(flow[i]);
        }
        const double q = sum > 0.0 ? fabs(throttle(GAIN(RADIUS_SPLIT), p, p - most)) / sum : 0.0;
        for (int i = 0; i < 4; i++) {
            flow[i] *= q;
            flow_c -= flow[i];
        }
    }
    for (int i = 0; i < 4; i++)
        if (v[i] < 0)
            flow[i] = -throttle(GAIN(RADIUS_OUT), x[1 + i], 0.0);

    const double s1 = sin(x[5]), c1 = cos(x[5]), s2 = sin(x[6]), c2 = cos(x[6]);
    double arm;
    const double spring = SPRING * (link(LEVER_S, FOOT_S, s1, c1, &arm) - SPRING_LENGTH);
    const double weight = WEIGHT2 * (s1 * c2 + c1 * s2);
    const double t1 = lower(LEVER_C, FOOT_C, s1, c1, w1, x[3], flow[2], &dx[3])
                    + lower(LEVER_D, FOOT_D, s1, c1, w1, x[4], flow[3], &dx[4])
                    + spring * arm + weight - WEIGHT_X * c1 + WEIGHT_Y * s1;
    const double t2 = upper(LEVER_A, ARM_YA, s2, c2, w2, x[1], flow[0], &dx[1])
                    + upper(LEVER_B, ARM_YB, s2, c2, w2, x[2], flow[1], &dx[2]) + weight;

    /* M = [[I1 + I2 - 2 a, I2 - a], [., I2]] */
    const double a = MASS2 * L12 * (L1X * s2 - L1Y * c2), slope = MASS2 * L12 * (L1X * c2 + L1Y * s2);
    const double b1 = t1 + slope * (2.0 * w1 + w2) * w2, b2 = t2 - slope * w1 * w1;
    const double per = 1.0 / (INERTIA1 * INERTIA2 - a * a), off = INERTIA2 - a;
    dx[0] = flow_c * (1.0 / V_CAPACITY);
    dx[5] = w1;
    dx[6] = w2;
    dx[7] = (INERTIA2 * b1 - off * b2) * per;
    dx[8] = ((INERTIA1 + INERTIA2 - 2.0 * a) * b2 - off * b1) * per;
}

/* One RK4 step of length h; the valves stand still. */
static void rk4(double *x, double h, const int *v)
{
    double k1[STATES], k2[STATES], k3[STATES], k4[STATES], y[STATES];

    rhs(x, v, k1);
    for (int i = 0; i < STATES; i++)
        y[i] = x[i] + 0.5 * h * k1[i];
    rhs(y, v, k2);
    for (int i = 0; i < STATES; i++)
        y[i] = x[i] + 0.5 * h * k2[i];
    rhs(y, v, k3);
    for (int i = 0; i < STATES; i++)
        y[i] = x[i] + h * k3[i];
    rhs(y, v, k4);
    for (int i = 0; i < STATES; i++)
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
static void integrate_tick(double *x, double since, const pulse *pulses)
{
    double t = 0.0;

    while (t < TICK) {
        int v[4];
        double next = TICK;
        for (int i = 0; i < 4; i++) {
            const double end = pulses[i].end - since;
            const int open = end > t + EDGE_EPS;
            v[i] = open ? (pulses[i].fills ? 1 : -1) : 0;
            if (open && end < next - EDGE_EPS)
                next = end;
        }
        rk4(x, next - t, v);
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

/* Right-hand side; x as in arm2_run, valves of A .. D: 1 fills, -1 lets out, 0 shut; dx in Pa/s, rad/s, rad/s2. */
void arm2_rhs(const double *x, const double *valves, double *dx)
{
    int v[4];
    for (int i = 0; i < 4; i++)
        v[i] = (valves[i] > 0.0) - (valves[i] < 0.0);
    rhs(x, v, dx);
}

static int in_range(const double *x)
{
    int good = fabs(x[5]) <= THETA1_MAX && fabs(x[6]) <= THETA2_MAX && isfinite(x[0] + x[7] + x[8]);
    for (int i = 1; i < 5; i++)
        good = good && x[i] >= P_LOW && x[i] <= P_HIGH;
    return good;
}

/*
 * n ticks of 1 ms. Order inside a tick: measure, control, log, start a PWM period if one is due, integrate.
 *
 * r         n x 4: theta1, theta2 [rad], p_a, p_c [Pa]
 * inj       n x 4: added at the controllers' inputs, whose units are rad and bar
 * biquads   4 x n_sections x 5 (b0, b1, b2, a1, a2), loops theta1, theta2, p_a, p_c, for errors in rad and bar
 * x         p_capacity, p_a .. p_d [Pa gauge], theta1, theta2 [rad], w1, w2 [rad/s]; the start, and on return the end
 * seed      the generator's 64-bit state, not 0; used with noise_on, which switches noise and converters
 * out       n x 14: theta1, theta2 [rad], p_a .. p_d [Pa] as measured, z of the four loops, u_a .. u_d [V]
 *
 * Controllers start from rest. Returns 0; or -1 for n_sections out of range; or the count of ticks done, where
 * the arm left the model's range (the rows from there on are not written).
 */
int arm2_run(int n, const double *r, const double *inj, const double *biquads, int n_sections, double *x,
             long long seed, int noise_on, double *out)
{
    if (n_sections < 0 || n_sections > MAX_SECTIONS)
        return -1;

    static const int measured[4] = {0, 1, 2, 4};
    static const double per_unit[4] = {1.0, 1.0, 1.0 / BAR, 1.0 / BAR};
    int sections[4];
    for (int i = 0; i < 4; i++)
        sections[i] = count_sections(n_sections, biquads + 5 * n_sections * i);
    double memory[4][2 * MAX_SECTIONS] = {{0.0}};
    generator noise = {seed ? (uint64_t)seed : 1, 0, 0.0};
    pulse pulses[4] = {{0, 0.0}, {0, 0.0}, {0, 0.0}, {0, 0.0}};
    double state[STATES];
    for (int i = 0; i < STATES; i++)
        state[i] = x[i];
    int phase = 0, done = 0;

    for (int k = 0; k < n; k++) {
        double *row = out + 14 * (long)k, *z = row + 6, *u = row + 10;
        row[0] = state[5];
        row[1] = state[6];
        for (int i = 1; i < 5; i++)
            row[1 + i] = state[i];
        if (noise_on) {
            for (int i = 0; i < 2; i++)
                row[i] = convert(row[i] + NOISE_THETA * gauss(&noise), LSB_THETA);
            for (int i = 2; i < 6; i++)
                row[i] = convert(row[i] + NOISE_P * gauss(&noise), LSB_P);
        }
        for (int i = 0; i < 4; i++) {
            const double e = (r[4 * k + i] - row[measured[i]]) * per_unit[i] + inj[4 * k + i];
            z[i] = cascade(sections[i], biquads + 5 * n_sections * i, memory[i], e);
        }
        u[0] = z[1] + z[2];
        u[1] = -z[1];
        u[2] = -z[0] + z[3];
        u[3] = z[0];

        if (phase == 0)
            for (int i = 0; i < 4; i++)
                pulses[i] = start_pulse(u[i]);
        integrate_tick(state, phase * TICK, pulses);
        if (++phase == TICKS_PER_PERIOD)
            phase = 0;

        if (!in_range(state)) {
            done = k + 1;
            break;
        }
    }

    for (int i = 0; i < STATES; i++)
        x[i] = state[i];
    return done;
}
