/* What a robot's end sends. */
#include <string.h>

#include "mom_rsp_internal.h"

/* The most bytes of a refusal. */
#define LONGEST_REFUSAL 1200
/* The bytes of a fragment before those of the blob. */
#define FRAGMENT_HEAD 11

/* ---- The handshake ---- */

static size_t handshake(const struct mom_rsp_robot *robot, uint8_t type, uint64_t now, const uint8_t *session, uint8_t *out, size_t room,
                        size_t size)
{
    struct mom_rsp_header header = {
        .version = 1,
        .model = robot->layout->id,
        .encryption = robot->keyed ? 1 : 0,
        .type = type,
        .stamp = (uint32_t)(now / 1000),
        .last = 0xFFFF,
        .buffers = mom_rsp_free_buffers(robot)
    };
    if (session != NULL)
        memcpy(header.session, session, sizeof header.session);
    mom_rsp_header_encode(&header, out);
    return mom_rsp_sign(robot, out, room, MOM_RSP_HEADER + size);
}

static size_t say_welcome(const struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t room)
{
    const struct mom_rsp_pending *pending = &robot->pending;
    uint8_t *to = out + MOM_RSP_HEADER;
    if (!pending->waits || room < MOM_RSP_HEADER + 65)
        return 0;
    memcpy(to, pending->welcome, 16);
    memcpy(to + 16, pending->hello, 16);
    memcpy(to + 32, robot->layout->hash, 32);
    to[64] = (uint8_t)robot->memory.buffer_count;
    return handshake(robot, MOM_RSP_WELCOME, now, pending->session, out, room, 65);
}

/* Puts the names and digests of all elements that fit; the bytes that are used then. */
static size_t put_names(const struct mom_rsp_layout *layout, uint8_t *to, size_t room, size_t used)
{
    for (size_t i = 0; i < layout->count; i++) {
        const struct mom_rsp_element *of = &layout->elements[i];
        size_t size = strlen(of->name);
        if (room - used < 5 + size)
            break;
        mom_rsp_put_32(to + used, of->digest);
        to[used + 4] = (uint8_t)size;
        memcpy(to + used + 5, of->name, size);
        used += 5 + size;
    }
    return used;
}

static size_t say_refusal(const struct mom_rsp_robot *robot, uint8_t reason, uint64_t now, uint8_t *out, size_t room)
{
    size_t most = room < LONGEST_REFUSAL ? room : LONGEST_REFUSAL;
    size_t used = 1 + MOM_RSP_NONCE + 32;
    if (most < MOM_RSP_HEADER + used + MOM_RSP_TAG)
        return 0;
    most -= MOM_RSP_HEADER + MOM_RSP_TAG;
    uint8_t *to = out + MOM_RSP_HEADER;
    to[0] = reason;
    memcpy(to + 1, robot->refused, MOM_RSP_NONCE);
    memcpy(to + 1 + MOM_RSP_NONCE, robot->layout->hash, 32);
    if (reason == MOM_RSP_OTHER_MODEL)
        used = put_names(robot->layout, to, most, used);
    return handshake(robot, MOM_RSP_REFUSAL, now, NULL, out, room, used);
}

/* ---- Data packets ---- */

/* A map and its payload, while they are written. */
struct writer {
    uint8_t *map;
    uint8_t *payload;
    size_t room, used;
};

static void put_bit(struct writer *writer, uint8_t element)
{
    writer->map[element / 8] = (uint8_t)(writer->map[element / 8] | 0x80 >> (element % 8));
}

/* Adds a bit with its id, where there is one, and its data, where `of` is given; false, with nothing written, where they do not fit. */
static bool put(struct writer *writer, uint8_t element, uint8_t id, const struct mom_rsp_element *of, const uint8_t *data, size_t size)
{
    bool counted = of != NULL && (of->type == MOM_RSP_BYTES || of->kind == MOM_RSP_MEMORY_EVENT);
    size_t head = (id != 0 ? 1u : 0u) + (counted ? 2u : 0u);
    if (writer->room - writer->used < head + size)
        return false;
    uint8_t *to = writer->payload + writer->used;
    if (id != 0)
        *to++ = id;
    if (counted) {
        mom_rsp_put_16(to, (uint16_t)size);
        to += 2;
    }
    if (size > 0)
        memcpy(to, data, size);
    writer->used += head + size;
    put_bit(writer, element);
    return true;
}

/* Ids go from 1 to 255, and on with 1. */
static uint8_t next_id(uint8_t id)
{
    return id == 255 ? 1 : (uint8_t)(id + 1);
}

static void put_sensor(struct mom_rsp_robot *robot, uint64_t now, uint8_t element, struct writer *writer)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    if (!mom_rsp_is(cell, MOM_RSP_HAS))
        return;
    /* A new value begins at most once in the sensor's own period, and is then in each packet until it is acknowledged. */
    uint32_t passed = (uint32_t)now - cell->at;
    if (mom_rsp_is(cell, MOM_RSP_NEW) && (cell->at == 0 || passed >= (uint32_t)of->period * 1000)) {
        mom_rsp_unflag(cell, MOM_RSP_NEW);
        mom_rsp_flag(cell, MOM_RSP_SENT);
        cell->first = (uint16_t)robot->traffic.next;
        cell->at = (uint32_t)now == 0 ? 1 : (uint32_t)now;
    }
    size_t size;
    const uint8_t *value = mom_rsp_stored(of, mom_rsp_bytes(robot, element), &size);
    bool is_due = robot->paper || (cell->flags & (MOM_RSP_SENT | MOM_RSP_ASKED)) != 0;
    if (is_due && put(writer, element, 0, of, value, size))
        mom_rsp_unflag(cell, MOM_RSP_ASKED);
}

static void put_event(struct mom_rsp_robot *robot, uint8_t element, struct writer *writer)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    if (cell->count == 0)
        return;
    if (!mom_rsp_is(cell, MOM_RSP_SENT)) {
        cell->id = next_id(cell->id);
        mom_rsp_flag(cell, MOM_RSP_SENT);
    }
    size_t size = mom_rsp_size(of);
    const uint8_t *data = mom_rsp_stored(of, mom_rsp_bytes(robot, element) + (size_t)cell->head % MOM_RSP_EVENTS * size, &size);
    put(writer, element, cell->id, of, data, size);
}

/* Sends the oldest memory event of an element that is held, once. */
static void put_held(struct mom_rsp_robot *robot, uint8_t element, struct writer *writer)
{
    struct mom_rsp_buffer *oldest = NULL;
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    for (size_t i = 0; i < robot->memory.buffer_count; i++) {
        struct mom_rsp_buffer *buffer = &robot->memory.buffers[i];
        if (buffer->order != 0 && buffer->element == element && (oldest == NULL || buffer->order < oldest->order))
            oldest = buffer;
    }
    if (oldest == NULL || !oldest->waits)
        return;
    if (oldest->id == 0) {
        cell->id = next_id(cell->id);
        oldest->id = cell->id;
    }
    const uint8_t *data = robot->memory.held + (size_t)(oldest - robot->memory.buffers) * robot->slot;
    oldest->waits = !put(writer, element, oldest->id, of, data, oldest->size);
}

/* Puts into a data packet what an element has to say. */
static void put_element(struct mom_rsp_robot *robot, uint64_t now, uint8_t element, struct writer *writer)
{
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    bool is_active = mom_rsp_is_active(robot, element);
    switch (robot->layout->elements[element].kind) {
    case MOM_RSP_SENSOR:
    case MOM_RSP_MONITOR:
        if (is_active)
            put_sensor(robot, now, element, writer);
        break;
    case MOM_RSP_COMMAND:
    case MOM_RSP_MEMORY_COMMAND:
        if (cell->count != 0 && put(writer, element, cell->count, NULL, NULL, 0))
            cell->count = 0;
        break;
    case MOM_RSP_EVENT:
        if (is_active)
            put_event(robot, element, writer);
        break;
    case MOM_RSP_MEMORY_EVENT:
        if (is_active)
            put_held(robot, element, writer);
        break;
    default:
        break;
    }
}

static size_t say_data(struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t room)
{
    uint64_t period = mom_rsp_period_us(robot);
    size_t map_size = mom_rsp_map_size(robot->layout);
    /* One late turn does not make the next ones come in a row. */
    robot->next = robot->next + period > now + period / 2 ? robot->next + period : now + period / 2;
    robot->budget_left = robot->budget;
    if (room < mom_rsp_largest_up(robot->layout))
        return 0;
    struct writer writer = { .map = out + MOM_RSP_HEADER, .payload = out + MOM_RSP_HEADER + map_size };
    writer.room = room - MOM_RSP_HEADER - map_size;
    memset(writer.map, 0, map_size);
    for (size_t i = 0; i < robot->layout->count; i++)
        put_element(robot, now, (uint8_t)i, &writer);
    return mom_rsp_close(robot, MOM_RSP_UP_DATA, now, out, room, map_size + writer.used);
}

/* ---- Control and fragments ---- */

static size_t say_control(struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t room)
{
    size_t map_size = mom_rsp_map_size(robot->layout);
    if (!robot->has_control || room < MOM_RSP_HEADER + 1 + map_size)
        return 0;
    out[MOM_RSP_HEADER] = robot->number;
    struct writer writer = { .map = out + MOM_RSP_HEADER + 1 };
    memset(writer.map, 0, map_size);
    for (size_t i = 0; i < robot->layout->count; i++)
        if (mom_rsp_is_active(robot, (uint8_t)i))
            put_bit(&writer, (uint8_t)i);
    return mom_rsp_close(robot, MOM_RSP_UP_CONTROL, now, out, room, 1 + map_size);
}

/* A part of a blob behind the data packet, as far as the budget goes. */
static size_t say_fragment(struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t room)
{
    struct mom_rsp_fragment fragment;
    uint8_t *head = out + MOM_RSP_HEADER;
    if (robot->body->next_fragment == NULL || robot->budget_left < MOM_RSP_FRAGMENT
        || room < MOM_RSP_HEADER + FRAGMENT_HEAD + MOM_RSP_FRAGMENT)
        return 0;
    memset(&fragment, 0, sizeof fragment);
    if (!robot->body->next_fragment(robot->self, &fragment, head + FRAGMENT_HEAD) || fragment.size > MOM_RSP_FRAGMENT)
        return 0;
    robot->budget_left = (uint16_t)(robot->budget_left - fragment.size);
    head[0] = fragment.element;
    mom_rsp_put_16(head + 1, fragment.blob);
    mom_rsp_put_32(head + 3, fragment.offset);
    mom_rsp_put_32(head + 7, fragment.total);
    return mom_rsp_close(robot, MOM_RSP_UP_FRAGMENT, now, out, room, FRAGMENT_HEAD + (size_t)fragment.size);
}

/* ---- What is due ---- */

static size_t poll_up(struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t room)
{
    if (robot->answers_control) {
        robot->answers_control = false;
        return say_control(robot, now, out, room);
    }
    if (now >= robot->due)
        mom_rsp_move_all(robot, now);
    if (now >= robot->next)
        return say_data(robot, now, out, room);
    return say_fragment(robot, now, out, room);
}

size_t mom_rsp_poll(struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t size)
{
    mom_rsp_watch(robot, now);
    if (robot->refusal != 0) {
        uint8_t reason = robot->refusal;
        robot->refusal = 0;
        return say_refusal(robot, reason, now, out, size);
    }
    if (robot->answers_welcome) {
        robot->answers_welcome = false;
        return say_welcome(robot, now, out, size);
    }
    if (robot->answers_end) {
        robot->answers_end = false;
        return mom_rsp_close(robot, MOM_RSP_UP_END, now, out, size, 0);
    }
    if (robot->phase == MOM_RSP_UP)
        return poll_up(robot, now, out, size);
    if (robot->phase == MOM_RSP_DOWN || now < robot->next)
        return 0;
    robot->next = now + mom_rsp_period_us(robot);
    return mom_rsp_close(robot, MOM_RSP_UP_END, now, out, size, 0);
}
