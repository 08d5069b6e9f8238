/* A recording: announced by BEGIN, fed by ROWS, started by GO, kept tick by tick until it has ended. */
#include "state.h"

#include <math.h>

void run_forget(void)
{
    memset(&target.run, 0, sizeof target.run);
    target.ended[0].waiting = 0;
    target.again_count = 0;
}

static int begin_possible(const struct recording *run, uint8_t *code, const char **why)
{
    const unsigned columns = 2u * target.c.loops;

    *code = 0;
    if (run->id == 0 || run->rows == 0 || run->injection > CONTROL || run->place > 1)
        *code = refuse(NO_RANGE, why, "run, rows, injection or place");
    else if (run->columns >> columns)
        *code = refuse(NO_RANGE, why, "a column of a loop that there is not");
    else if (run->injection == CONTROL && target.l.trial.share > 0.0)
        *code = refuse(NO_RANGE, why, "loops stay closed during a trial");
    else if (run->place && !(target.board->flags & BOARD_EMULATED))
        *code = refuse(NO_SUPPORT, why, "a real machine cannot be placed");
    else if (run->place && !board_place(target.c.outputs, target.c.loops, target.l.to, 0))
        *code = refuse(NO_RANGE, why, "the machine has no rest at this setpoint");
    return *code == 0;
}

static uint32_t free_rows(void)
{
    const uint32_t waiting = target.run.numbers ? target.run.taken - target.run.tick : 0;
    return TARGET_ROWS - waiting;
}

uint8_t ask_begin(struct reader *in, struct writer *out, const char **why)
{
    struct recording run;
    uint8_t code = 0;

    memset(&run, 0, sizeof run);
    run.id = take_u32(in);
    run.rows = take_u32(in);
    run.injection = take_u8(in);
    run.columns = take_u16(in);
    run.noise = take_bits(in, 8);
    run.place = take_u8(in);
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "BEGIN has another length");
    if (!begin_possible(&run, &code, why))
        return code;
    for (unsigned k = 0; k < 2u * target.c.loops; k++)
        run.numbers = (uint8_t)(run.numbers + ((run.columns >> k) & 1u));
    run.width = (uint8_t)(3 * target.c.loops + target.board->sensors + target.board->commands);
    run.taken = run.numbers ? 0 : run.rows; /* where nothing moves, no row has to come */
    run.announced = 1;
    run_forget();
    target.run = run;
    put_u32(out, free_rows());
    return 0;
}

static void take_row(struct reader *in, uint32_t row)
{
    number *to = target.excitation + (size_t)(row % TARGET_ROWS) * target.run.numbers;
    for (uint8_t k = 0; k < target.run.numbers; k++)
        to[k] = take_number(in);
}

static int rows_finite(struct reader in, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (!isfinite(take_number(&in)))
            return 0;
    return 1;
}

uint8_t ask_rows(struct reader *in, struct writer *out, const char **why)
{
    struct recording *run = &target.run;
    const uint32_t id = take_u32(in), first = take_u32(in);
    const uint8_t count = take_u8(in);

    if (in->short_of)
        return refuse(NO_MALFORMED, why, "ROWS has another length");
    if (id == 0 || id != run->id)
        return refuse(NO_RUN, why, "no such recording is announced");
    if (!run->announced) { /* it has ended while the host sent */
        put_u32(out, run->taken);
        put_u32(out, 0);
        return 0;
    }
    if (in->left != (size_t)count * run->numbers * TARGET_NUMBER_BYTES)
        return refuse(NO_MALFORMED, why, "ROWS has another length");
    if (first > run->rows || count > run->rows - first)
        return refuse(NO_RANGE, why, "more rows than were announced");
    if (!rows_finite(*in, (size_t)count * run->numbers))
        return refuse(NO_RANGE, why, "a row holds what is no number");
    for (uint32_t row = first; row - first < count; row++) {
        if (row == run->taken && free_rows() > 0) {
            take_row(in, row);
            run->taken++;
        } else {
            in->data += (size_t)run->numbers * TARGET_NUMBER_BYTES;
            in->left -= (size_t)run->numbers * TARGET_NUMBER_BYTES;
        }
    }
    put_u32(out, run->taken);
    put_u32(out, free_rows());
    return 0;
}

uint8_t ask_go(struct reader *in, struct writer *out, const char **why)
{
    const uint32_t id = take_u32(in);

    (void)out;
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "GO has another length");
    if (id == 0 || id != target.run.id || !target.run.announced)
        return refuse(NO_RUN, why, "no such recording is announced");
    if (target.run.place && !board_place(target.c.outputs, target.c.loops, target.l.to, 0))
        return refuse(NO_RANGE, why, "the machine has no rest at this setpoint");
    target.state = RUNNING;
    return 0;
}

uint8_t ask_again(struct reader *in, struct writer *out, const char **why)
{
    const struct recording *run = &target.run;
    const uint32_t id = take_u32(in), first = take_u32(in);
    const uint16_t count = take_u16(in);

    (void)out;
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "AGAIN has another length");
    if (id == 0 || id != run->id)
        return refuse(NO_RUN, why, "no samples of such a recording");
    if (count == 0 || first >= run->tick || count > run->tick - first || run->tick - first > TARGET_TICKS)
        return refuse(NO_RANGE, why, "samples that are not kept");
    uint8_t at = 0;
    while (at < target.again_count && target.again[at].first != first)
        at++;
    if (at == AGAIN_MOST) /* what is forgotten will be asked for once more */
        at--;
    target.again[at] = (struct range){first, count};
    if (at == target.again_count)
        target.again_count++;
    return 0;
}

/* The first tick of a recording is about to come: a PWM period begins with it. */
void run_start(void)
{
    struct loops *l = &target.l;

    target.run.going = 1;
    if (target.run.noise != 0)
        board_noise(target.run.noise);
    if (target.run.place) {
        (void)board_place(target.c.outputs, target.c.loops, l->to, 1);
        l->way = l->ways;
        loops_rest();
    }
    target.samples_ms = target.now_ms;
}

int run_row(void)
{
    struct loops *l = &target.l;
    const struct recording *run = &target.run;
    const number *from = target.excitation + (size_t)(run->tick % TARGET_ROWS) * run->numbers;

    if (run->tick >= run->taken)
        return 0;
    for (uint8_t k = 0; k < target.c.loops; k++) {
        l->r[k] = (run->columns >> (2 * k)) & 1 ? (double)*from++ : l->to[k];
        l->n[k] = (run->columns >> (2 * k + 1)) & 1 ? (double)*from++ : 0.0;
    }
    return 1;
}

void run_sample(void)
{
    const struct loops *l = &target.l;
    number *to = target.memory + (size_t)(target.run.tick % TARGET_TICKS) * target.run.width;

    for (uint8_t k = 0; k < target.c.loops; k++)
        *to++ = (number)l->r[k];
    for (uint8_t k = 0; k < target.c.loops; k++)
        *to++ = (number)l->n[k];
    for (uint8_t k = 0; k < target.c.loops; k++)
        *to++ = (number)l->z[k];
    for (uint8_t k = 0; k < target.board->sensors + target.board->commands; k++)
        *to++ = (number)l->measured[k];
    target.run.tick++;
}

void run_end(uint8_t reason, uint8_t index, double value, double limit, const char *sentence)
{
    struct recording *run = &target.run;
    struct ended *end = &target.ended[run->announced ? 0 : 1];
    const uint32_t tick = run->announced ? run->tick : 0;
    const uint8_t open = run->going && run->injection == CONTROL;
    const uint8_t on_tick = (reason == LIMIT || reason == RATE_LIMIT || reason == TRIAL) && tick > 0; /* its sample was the last */

    memset(end, 0, sizeof *end);
    end->waiting = 1;
    end->run = run->announced ? run->id : 0;
    end->ticks = tick;
    end->tick = on_tick ? tick - 1 : tick;
    end->reason = reason;
    end->index = index;
    end->value = value;
    end->limit = limit;
    strncat(end->sentence, sentence, sizeof end->sentence - 1);
    run->announced = run->going = 0;
    if (target.state == RUNNING)
        target.state = ARMED;
    if (open)
        loops_start_here(target.c.soft_start_s);
}
