/*
 * The arm of arm1.c, LANES of them side by side: one loop over lanes for each step, which the compiler turns to vectors.
 *
 *     cc -O3 -std=gnu99 -march=native -fno-math-errno -fno-trapping-math -DLANES=8 -shared -fPIC arm1_lanes.c -lm
 *
 * A vector has no branches: both sides of each are computed and one is chosen. Valves close at other times in each arm,
 * so a tick takes as many steps as the arm with most edges needs; arms that are done take steps of no length meanwhile.
 */

#include "arm1.c"

#ifndef LANES
#define LANES 8
#endif

/* Sine and cosine within THETA_MAX, by series to rounding: the library's are calls, which end a vector. */
IN_LINE void turn(double x, double *sine, double *cosine)
{
    const double s = x * x;
    *sine = x * (1.0 + s * (-1.0 / 6.0 + s * (1.0 / 120.0 + s * (-1.0 / 5040.0 + s * (1.0 / 362880.0
          + s * (-1.0 / 39916800.0 + s * (1.0 / 6227020800.0 - s * (1.0 / 1307674368000.0))))))));
    *cosine = 1.0 + s * (-0.5 + s * (1.0 / 24.0 + s * (-1.0 / 720.0 + s * (1.0 / 40320.0 + s * (-1.0 / 3628800.0
            + s * (1.0 / 479001600.0 + s * (-1.0 / 87178291200.0 + s * (1.0 / 20922789888000.0))))))));
}

/* As rhs, without branches; valves are 0.0 or 1.0, in-valves only of muscles whose out-valve is closed. */
IN_LINE void rates(double p_c, double p_a, double p_b, double theta, double w, double in_a, double in_b, double out_a,
                   double out_b, double *d_c, double *d_a, double *d_b, double *d_w)
{
    const double drop_a = p_c - p_a, drop_b = p_c - p_b;
    const double size_a = fabs(drop_a), size_b = fabs(drop_b), sum = size_a + size_b;
    const double one_a = GAIN(RADIUS_SPLIT) * sqrt(size_a * (p_c + p_a + 2.0 * P_ATM));
    const double one_b = GAIN(RADIUS_SPLIT) * sqrt(size_b * (p_c + p_b + 2.0 * P_ATM));
    const double both = in_a * in_b;
    const double most = size_a > size_b ? one_a : one_b;
    const double share = most / (sum > 0.0 ? sum : 1.0);
    double flow_a = in_a * (both != 0.0 ? share * drop_a : copysign(one_a, drop_a));
    double flow_b = in_b * (both != 0.0 ? share * drop_b : copysign(one_b, drop_b));
    const double flow_c = throttle(GAIN(RADIUS_IN), P_SUPPLY, p_c) - (flow_a + flow_b);
    double sine, cosine;

    flow_a -= out_a * throttle(GAIN(RADIUS_OUT), p_a, 0.0);
    flow_b -= out_b * throttle(GAIN(RADIUS_OUT), p_b, 0.0);
    turn(theta, &sine, &cosine);
    const double torque = muscle(LEVER_A, ARM_YA, sine, cosine, w, p_a, flow_a, d_a)
                        + muscle(LEVER_B, ARM_YB, sine, cosine, w, p_b, flow_b, d_b);
    *d_c = flow_c * (1.0 / V_CAPACITY);
    *d_w = (torque + WEIGHT * sine) * (1.0 / INERTIA);
}

typedef struct {
    double x[5][LANES];
    double end_a[LANES], end_b[LANES]; /* [s] after the tick's begin */
    double fills_a[LANES], fills_b[LANES];
    double t[LANES];
} arms;

/* One step of every arm, to its next edge or the tick's end; gives whether an arm is not there yet. */
static int step(arms *s)
{
    double left = 0.0;

    for (int l = 0; l < LANES; l++) {
        const double t = s->t[l], end_a = s->end_a[l], end_b = s->end_b[l];
        const double open_a = end_a > t + EDGE_EPS ? 1.0 : 0.0, open_b = end_b > t + EDGE_EPS ? 1.0 : 0.0;
        const double to_a = open_a * (end_a < TICK - EDGE_EPS ? 1.0 : 0.0) != 0.0 ? end_a : TICK;
        const double to_b = open_b * (end_b < to_a - EDGE_EPS ? 1.0 : 0.0) != 0.0 ? end_b : to_a;
        const double h = to_b - t;
        const double in_a = open_a * s->fills_a[l], in_b = open_b * s->fills_b[l];
        const double out_a = open_a - in_a, out_b = open_b - in_b;
        const double c = s->x[0][l], a = s->x[1][l], b = s->x[2][l], q = s->x[3][l], w = s->x[4][l];
        double c1, a1, b1, w1, c2, a2, b2, w2, c3, a3, b3, w3, c4, a4, b4, w4;

        rates(c, a, b, q, w, in_a, in_b, out_a, out_b, &c1, &a1, &b1, &w1);
        const double v2 = w + 0.5 * h * w1;
        rates(c + 0.5 * h * c1, a + 0.5 * h * a1, b + 0.5 * h * b1, q + 0.5 * h * w, v2, in_a, in_b, out_a, out_b,
              &c2, &a2, &b2, &w2);
        const double v3 = w + 0.5 * h * w2;
        rates(c + 0.5 * h * c2, a + 0.5 * h * a2, b + 0.5 * h * b2, q + 0.5 * h * v2, v3, in_a, in_b, out_a, out_b,
              &c3, &a3, &b3, &w3);
        const double v4 = w + h * w3;
        rates(c + h * c3, a + h * a3, b + h * b3, q + h * v3, v4, in_a, in_b, out_a, out_b, &c4, &a4, &b4, &w4);
        s->x[0][l] = c + h / 6.0 * (c1 + 2.0 * (c2 + c3) + c4);
        s->x[1][l] = a + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
        s->x[2][l] = b + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4);
        s->x[3][l] = q + h / 6.0 * (w + 2.0 * (v2 + v3) + v4);
        s->x[4][l] = w + h / 6.0 * (w1 + 2.0 * (w2 + w3) + w4);
        s->t[l] = to_b;
        left += TICK - to_b;
    }
    return left > 0.0;
}

/*
 * As arm1_run for LANES arms: r n x 2 x LANES, x 5 x LANES, seeds LANES, out LANES x n x 7; nothing is injected.
 * Gives the steps of all ticks, or -1 for n_sections out of range; an arm that leaves its range is not stopped.
 */
long arm1_lanes(int n, const double *r, const double *biquads, int n_sections, double *x, const long long *seeds,
                int noise_on, double *out)
{
    if (n_sections < 0 || n_sections > MAX_SECTIONS)
        return -1;

    const double *c_theta = biquads, *c_p = biquads + 5 * n_sections;
    const int n_theta = count_sections(n_sections, c_theta), n_p = count_sections(n_sections, c_p);
    static double s_theta[LANES][2 * MAX_SECTIONS], s_p[LANES][2 * MAX_SECTIONS];
    static arms s;
    generator noise[LANES];
    pulse a[LANES], b[LANES];
    long steps = 0;

    for (int l = 0; l < LANES; l++) {
        for (int i = 0; i < 2 * MAX_SECTIONS; i++)
            s_theta[l][i] = s_p[l][i] = 0.0;
        for (int i = 0; i < 5; i++)
            s.x[i][l] = x[i * LANES + l];
        noise[l] = (generator){(uint64_t)seeds[l], 0, 0.0};
    }
    for (int k = 0; k < n; k++) {
        const int phase = k % TICKS_PER_PERIOD;
        for (int l = 0; l < LANES; l++) {
            double theta = s.x[3][l], p_a = s.x[1][l], p_b = s.x[2][l];
            if (noise_on) {
                theta = convert(theta + NOISE_THETA * gauss(&noise[l]), LSB_THETA);
                p_a = convert(p_a + NOISE_P * gauss(&noise[l]), LSB_P);
                p_b = convert(p_b + NOISE_P * gauss(&noise[l]), LSB_P);
            }
            const double z_theta = cascade(n_theta, c_theta, s_theta[l], r[(2 * k) * LANES + l] - theta);
            const double z_p = cascade(n_p, c_p, s_p[l], (r[(2 * k + 1) * LANES + l] - (p_a + p_b)) * (1.0 / BAR));
            const double u_a = z_theta + z_p, u_b = -z_theta + z_p;
            const double row[7] = {theta, p_a, p_b, z_theta, z_p, u_a, u_b};

            for (int i = 0; i < 7; i++)
                out[((long)l * n + k) * 7 + i] = row[i];
            if (phase == 0) {
                a[l] = start_pulse(u_a);
                b[l] = start_pulse(u_b);
            }
            s.end_a[l] = a[l].end - phase * TICK;
            s.end_b[l] = b[l].end - phase * TICK;
            s.fills_a[l] = a[l].fills;
            s.fills_b[l] = b[l].fills;
            s.t[l] = 0.0;
        }
        do
            steps++;
        while (step(&s));
    }
    for (int l = 0; l < LANES; l++)
        for (int i = 0; i < 5; i++)
            x[i * LANES + l] = s.x[i][l];
    return steps;
}
