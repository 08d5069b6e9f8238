/*
 * A motor axis simulated on the chip itself: two inertias with a spring between them, a current in, the motor's angle out.
 *
 *     motor  J w' = k i - d w - c (a - b) - e (w - v)      load  L v' = c (a - b) + e (w - v)
 *
 * Single precision, for the chip's own FPU: one step of Runge and Kutta's fourth order a tick. Made safe, a brake holds it.
 */
#include "chip.h"
#include "../../board.h"
#include "../../target.h"

#define MOTOR 6e-5f      /* kg m2 */
#define LOAD 4e-5f       /* kg m2 */
#define TORQUE 0.056f    /* N m/A */
#define DAMPING 4e-4f    /* N m s/rad, of the motor */
#define SPRING 6.06f     /* N m/rad: 80 Hz, free at both ends */
#define LOSS 4.8e-4f     /* N m s/rad, of the spring: 2 % */
#define NOISE 1e-5f      /* rad, rms */
#define ANGLE 3.15f      /* rad: end stops */
#define CURRENT 10.0f    /* A */
#define STEP (1.0f / RATE_HZ)

struct motion {
    float a, w, b, v; /* motor's angle and speed, the load's */
};

static const char *const COLUMNS[] = {"theta_m_rad", "u_current_a"};
static const double RANGES[][2] = {{-3.2, 3.2}, {-10.0, 10.0}};
static const struct board_info INFO = {
    "STM32F4, simulated axis", TARGET_VERSION, 1, 1, COLUMNS, RANGES, RATE_HZ, 0.0, 0.0, BOARD_EMULATED};
static struct motion axis;
static float current;
static uint64_t noise = 1;
static int safe;

const struct board_info *board_info(void)
{
    return &INFO;
}

/* Four draws from 0 to 1 (xorshift, Marsaglia 2003), summed: nearly normal. */
static float drawn(void)
{
    float sum = -2.0f;
    noise ^= noise << 13;
    noise ^= noise >> 7;
    noise ^= noise << 17;
    for (unsigned k = 0; k < 4; k++)
        sum += (float)(noise >> 16 * k & 0xFFFFu) / 65536.0f;
    return sum * 1.7320508f;
}

void board_read(double *sensors)
{
    sensors[0] = (double)(axis.a + NOISE * drawn());
}

void board_give(const double *commands)
{
    const float asked = (float)commands[0];
    current = asked > CURRENT ? CURRENT : asked < -CURRENT ? -CURRENT : asked;
}

void board_enable(void)
{
    current = 0.0f;
    safe = 0;
    watched.latest = 0;
}

void board_safe(void)
{
    if (!safe)
        watched.safe_at = watched.ticks;
    safe = 1;
}

int board_place(const double *outputs, uint8_t loops, const double *references, int now)
{
    const double angle = references[0] / outputs[0];

    if (loops != 1 || !(angle > -3.0 && angle < 3.0))
        return 0;
    if (now)
        axis = (struct motion){(float)angle, 0.0f, (float)angle, 0.0f};
    return 1;
}

void board_noise(uint64_t state)
{
    noise = state ? state : 1u;
}

void machine_init(void)
{
    board_safe();
}

static struct motion change(struct motion x)
{
    const float between = SPRING * (x.a - x.b) + LOSS * (x.w - x.v);
    return (struct motion){x.w, (TORQUE * current - DAMPING * x.w - between) / MOTOR, x.v, between / LOAD};
}

static struct motion along(struct motion x, float s, struct motion d)
{
    return (struct motion){x.a + s * d.a, x.w + s * d.w, x.b + s * d.b, x.v + s * d.v};
}

void machine_tick(void)
{
    const struct motion k1 = change(axis), k2 = change(along(axis, STEP / 2.0f, k1));
    const struct motion k3 = change(along(axis, STEP / 2.0f, k2)), k4 = change(along(axis, STEP, k3));

    axis = along(along(along(along(axis, STEP / 6.0f, k1), STEP / 3.0f, k2), STEP / 3.0f, k3), STEP / 6.0f, k4);
    if (safe || !(axis.a > -ANGLE && axis.a < ANGLE && axis.b > -ANGLE && axis.b < ANGLE)) {
        const float kept = axis.a < -ANGLE ? -ANGLE : axis.a > ANGLE ? ANGLE : axis.a;
        axis = (struct motion){kept, 0.0f, kept, 0.0f};
    }
}
