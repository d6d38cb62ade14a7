/*
 * Numbers, and the motion filter: one output each period, whatever arrived meanwhile.
 *
 * An output follows the packet that brought its value: a clock of the filter's own would let each value wait for its turn, up to a whole
 * period. Two outputs are 7/8 of a period apart at least, so that packets may come a little early; what needs more outputs to get there has
 * them 9/8 of a period apart, so that the next packet comes before them and its value need not wait.
 */
#include <string.h>

#include "mom_rsp_internal.h"

/* ---- Numbers of the wire: whole ones wrap in their type, of an f32 the value is its bits ---- */

/* The number of the type that has the same low bits. */
static int64_t wrap(uint8_t type, int64_t value)
{
    uint64_t bits = (uint64_t)value;
    switch (type) {
    case MOM_RSP_U8:
        return (int64_t)(bits & 0xFF);
    case MOM_RSP_I8:
        return (int64_t)((bits & 0xFF) ^ 0x80) - 0x80;
    case MOM_RSP_U16:
        return (int64_t)(bits & 0xFFFF);
    case MOM_RSP_I16:
        return (int64_t)((bits & 0xFFFF) ^ 0x8000) - 0x8000;
    case MOM_RSP_I32:
        return (int64_t)((bits & 0xFFFFFFFF) ^ 0x80000000) - 0x80000000LL;
    default:
        return (int64_t)(bits & 0xFFFFFFFF);
    }
}

static int64_t load(uint8_t type, const uint8_t *from)
{
    uint32_t value = 0;
    for (size_t i = 0; i < mom_rsp_number_size(type); i++)
        value = value << 8 | from[i];
    return wrap(type, (int64_t)value);
}

static void store(uint8_t type, int64_t value, uint8_t *to)
{
    uint64_t bits = (uint64_t)value;
    for (size_t i = mom_rsp_number_size(type); i-- > 0; bits >>= 8)
        to[i] = (uint8_t)bits;
}

static float to_float(int64_t value)
{
    uint32_t bits = (uint32_t)value;
    float number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

static int64_t of_float(float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    return (int64_t)bits;
}

/* The whole part, at most as far from 0 as the type goes; 0 of a NaN. */
static int64_t whole(double number)
{
    if (number >= 9223372036854775808.0)
        return INT64_MAX;
    if (number <= -9223372036854775808.0)
        return INT64_MIN;
    return number == number ? (int64_t)number : 0;
}

/* The nearest number that the type has. */
static int64_t saturate(uint8_t type, int64_t value)
{
    unsigned bits = (unsigned)mom_rsp_number_size(type) * 8;
    bool is_signed = type == MOM_RSP_I8 || type == MOM_RSP_I16 || type == MOM_RSP_I32;
    int64_t high = ((int64_t)1 << (is_signed ? bits - 1 : bits)) - 1;
    int64_t low = is_signed ? -high - 1 : 0;
    return value < low ? low : value > high ? high : value;
}

/* At most so far from 0. */
static int64_t within(int64_t value, float limit)
{
    int64_t most = whole((double)limit);
    int64_t up = value > -most ? value : -most;
    return up < most ? up : most;
}

static float size_of(float number)
{
    return number < 0.0f ? -number : number;
}

/* `now` moved towards `goal` by at most `limit`; less than 0 is none. */
static int64_t approach(uint8_t type, int64_t now, int64_t goal, float limit)
{
    if (limit < 0.0f)
        return goal;
    if (type != MOM_RSP_F32)
        return now + within(goal - now, limit);
    float all = to_float(goal) - to_float(now);
    if (size_of(all) > limit)
        return of_float(to_float(now) + (all < 0.0f ? -limit : limit));
    return goal;
}

/* The point between `from` and `to` that lies at `part`, 0 to 1, of the way. */
static int64_t between(uint8_t type, int64_t from, int64_t to, float part)
{
    if (part >= 1.0f)
        return to;
    if (type == MOM_RSP_F32)
        return of_float(to_float(from) * (1.0f - part) + to_float(to) * part);
    return from + whole((double)((float)(to - from) * part));
}

/* Whether all numbers of an effector's value are finite. */
bool mom_rsp_is_finite(const struct mom_rsp_element *of, const uint8_t *value, size_t size)
{
    if (of->type != MOM_RSP_F32)
        return true;
    for (size_t at = 0; at + 4 <= size; at += 4)
        if ((mom_rsp_get_32(value + at) & 0x7F800000u) == 0x7F800000u)
            return false;
    return true;
}

/* ---- The parts of each number of an effector ---- */

/* The newest value (or the total that was heard), the last output (or the total that was put out), and where it came from (or the step). */
struct parts {
    int64_t newest, output, from;
};

static struct parts get_parts(uint8_t type, const uint8_t *bytes, size_t size, size_t at)
{
    struct parts parts = { load(type, bytes + at), load(type, bytes + size + at), load(type, bytes + 2 * size + at) };
    return parts;
}

static void set_parts(uint8_t type, uint8_t *bytes, size_t size, size_t at, const struct parts *parts)
{
    store(type, parts->newest, bytes + at);
    store(type, parts->output, bytes + size + at);
    store(type, parts->from, bytes + 2 * size + at);
}

/* How much of the way of one period has passed, 0 to 1. */
static float share(uint64_t now, uint32_t at, uint64_t period)
{
    float passed = (float)((uint32_t)now - at) / (float)period;
    return passed < 1.0f ? passed : 1.0f;
}

/* A value is here that was not put out yet. */
static void plan(struct mom_rsp_robot *robot, uint64_t now)
{
    uint64_t period = mom_rsp_period_us(robot);
    /* All has rested. A limit of change allows what it does in one period: a rest is not made up for in one step. */
    if (robot->due == MOM_RSP_NEVER && robot->moved < mom_rsp_since(now, period))
        robot->moved = now - period;
    uint64_t due = robot->moved + period - period / 8;
    if (due < robot->due)
        robot->due = due;
}

/* A total was heard: what is given already, so that no more waits than the type holds. */
static void hear_total(const struct mom_rsp_robot *robot, uint8_t type, struct parts *parts, int64_t value)
{
    if (type == MOM_RSP_F32) {
        /* In paper mode all that arrives between two outputs adds up. */
        parts->newest = robot->paper ? of_float(to_float(parts->newest) + to_float(value)) : value;
        return;
    }
    int64_t total = robot->paper ? wrap(type, parts->newest + value) : value;
    int64_t waits = wrap(type, parts->newest - parts->output) + wrap(type, total - parts->newest);
    parts->output = wrap(type, total - saturate(type, waits));
    parts->newest = total;
}

/* An effector's value is here: a total of an incremental one, or its steps in paper mode. */
void mom_rsp_hear_value(struct mom_rsp_robot *robot, uint64_t now, uint8_t element, const uint8_t *value, size_t size)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    uint8_t *bytes = mom_rsp_bytes(robot, element);
    if (!mom_rsp_is_number(of->type)) {
        mom_rsp_store(of, bytes, value, size);
        mom_rsp_flag(cell, MOM_RSP_NEW);
        plan(robot, now);
        return;
    }
    if (of->motion != MOM_RSP_INCREMENTAL && memcmp(bytes, value, size) == 0)
        return;
    float passed = of->motion == MOM_RSP_INTERPOLATED ? share(now, cell->at, mom_rsp_period_us(robot)) : 1.0f;
    for (size_t at = 0; at < size; at += mom_rsp_number_size(of->type)) {
        struct parts parts = get_parts(of->type, bytes, size, at);
        int64_t heard = load(of->type, value + at);
        if (of->motion == MOM_RSP_INCREMENTAL) {
            hear_total(robot, of->type, &parts, heard);
        } else {
            /* Where the way had got to is where the next one begins. */
            parts.from = between(of->type, parts.from, parts.newest, passed);
            parts.newest = heard;
        }
        set_parts(of->type, bytes, size, at, &parts);
    }
    cell->at = (uint32_t)now;
    mom_rsp_flag(cell, MOM_RSP_NEW);
    plan(robot, now);
}

/* The change that the rate allows now, less than 0 for any; of whole numbers what is less than one unit is kept for the next time. */
static float allowance(const struct mom_rsp_element *of, struct mom_rsp_cell *cell, uint64_t elapsed)
{
    if (of->rate == 0.0f)
        return -1.0f;
    float all = cell->credit + of->rate * ((float)elapsed / 1e6f);
    if (of->type == MOM_RSP_F32)
        return all;
    float units = (float)whole((double)all);
    cell->credit = all - units;
    return units;
}

/* The next step towards a total; `parts->from` is the step. */
static void give(uint8_t type, struct parts *parts, float limit)
{
    if (type != MOM_RSP_F32) {
        int64_t all = wrap(type, parts->newest - parts->output);
        parts->from = limit < 0.0f ? all : within(all, limit);
        parts->output = wrap(type, parts->output + parts->from);
        return;
    }
    float all = to_float(parts->newest) - to_float(parts->output);
    if (limit >= 0.0f && size_of(all) > limit) {
        float part = all < 0.0f ? -limit : limit;
        parts->from = of_float(part);
        parts->output = of_float(to_float(parts->output) + part);
        return;
    }
    /* The whole way ends exactly at the total, whatever was rounded on it. */
    parts->from = of_float(all);
    parts->output = parts->newest;
}

/* Puts out what is new of an effector of numbers, and says whether it has still some way to go. */
static bool move_numbers(struct mom_rsp_robot *robot, uint64_t now, uint64_t elapsed, uint8_t element)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    uint8_t *bytes = mom_rsp_bytes(robot, element);
    size_t size = mom_rsp_size(of);
    bool is_sum = of->motion == MOM_RSP_INCREMENTAL;
    float limit = allowance(of, cell, elapsed);
    float part = of->motion == MOM_RSP_INTERPOLATED ? share(now, cell->at, mom_rsp_period_us(robot)) : 1.0f;
    bool moved = false, arrived = part >= 1.0f;
    for (size_t at = 0; at < size; at += mom_rsp_number_size(of->type)) {
        struct parts parts = get_parts(of->type, bytes, size, at);
        int64_t before = parts.output;
        if (is_sum) {
            give(of->type, &parts, limit);
        } else {
            parts.output = approach(of->type, before, between(of->type, parts.from, parts.newest, part), limit);
            if (part >= 1.0f)
                parts.from = parts.newest;
        }
        moved = moved || parts.output != before;
        arrived = arrived && parts.output == parts.newest;
        set_parts(of->type, bytes, size, at, &parts);
    }
    if (arrived) {
        mom_rsp_unflag(cell, MOM_RSP_NEW);
        cell->credit = 0.0f;
    }
    if (moved)
        robot->body->effector(robot->self, element, bytes + (is_sum ? 2 : 1) * size, size);
    return !arrived;
}

static bool move_one(struct mom_rsp_robot *robot, uint64_t now, uint64_t elapsed, uint8_t element)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    if (of->kind != MOM_RSP_EFFECTOR || !mom_rsp_is(cell, MOM_RSP_NEW))
        return false;
    if (mom_rsp_is_number(of->type))
        return move_numbers(robot, now, elapsed, element);
    size_t size;
    const uint8_t *value = mom_rsp_stored(of, mom_rsp_bytes(robot, element), &size);
    mom_rsp_unflag(cell, MOM_RSP_NEW);
    robot->body->effector(robot->self, element, value, size);
    return false;
}

/* Puts out what is new, of all effectors. */
void mom_rsp_move_all(struct mom_rsp_robot *robot, uint64_t now)
{
    uint64_t elapsed = mom_rsp_since(now, robot->moved);
    uint64_t period = mom_rsp_period_us(robot);
    robot->moved = now;
    robot->due = MOM_RSP_NEVER;
    for (size_t i = 0; i < robot->layout->count; i++)
        if (move_one(robot, now, elapsed, (uint8_t)i))
            robot->due = now + period + period / 8;
}

/* The bytes of an effector that has its safe value, and has been told nothing. */
void mom_rsp_rest(const struct mom_rsp_element *of, uint8_t *bytes)
{
    size_t size = mom_rsp_is_number(of->type) ? 3 * mom_rsp_size(of) : of->safe_size;
    for (size_t i = 0; i < size; i++)
        bytes[i] = of->motion == MOM_RSP_INCREMENTAL ? 0 : of->safe[i % of->safe_size];
}

/* An effector has nobody to command it: its safe value, at once. */
void mom_rsp_make_safe(struct mom_rsp_robot *robot, uint8_t element)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    size_t size;
    mom_rsp_unflag(cell, MOM_RSP_NEW);
    cell->credit = 0.0f;
    mom_rsp_rest(of, mom_rsp_bytes(robot, element));
    const uint8_t *safe = mom_rsp_stored(of, of->safe, &size);
    robot->body->effector(robot->self, element, safe, size);
}

/* ---- Numbers in their units ---- */

void mom_rsp_decode(const struct mom_rsp_quantity *quantities, size_t size, bool limited, const uint8_t *from, double *to, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const struct mom_rsp_quantity *of = &quantities[i < size ? i : 0];
        int64_t wire = load(of->type, from + i * mom_rsp_number_size(of->type));
        double value = (of->type == MOM_RSP_F32 ? (double)to_float(wire) : (double)wire) * of->scale;
        if (limited && !(value >= of->min))
            value = of->min;
        if (limited && value > of->max)
            value = of->max;
        to[i] = value;
    }
}

bool mom_rsp_encode(const struct mom_rsp_quantity *quantities, size_t size, const double *from, uint8_t *to, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const struct mom_rsp_quantity *of = &quantities[i < size ? i : 0];
        /* What came of a number of the wire must go back there, whatever its last digit. */
        double slack = of->scale * 1e-6;
        if (!(from[i] >= of->min - slack && from[i] <= of->max + slack))
            return false;
        double wire = from[i] / of->scale;
        int64_t number;
        if (of->type == MOM_RSP_F32)
            number = of_float((float)wire);
        else
            number = saturate(of->type, whole(wire + (wire < 0.0 ? -0.5 : 0.5)));
        store(of->type, number, to + i * mom_rsp_number_size(of->type));
    }
    return true;
}
