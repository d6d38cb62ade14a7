/* What a robot's end does with a datagram. */
#include <string.h>

#include "mom_rsp_internal.h"

/* Hellos that are answered in a second. */
#define ANSWERS 10
/* A session is alive for so long after its last data packet where there is no watchdog, µs. */
#define ALIVE 500000u

/* ---- What is activated ---- */

/* An element is active now, or is not. */
static void changed(struct mom_rsp_robot *robot, uint8_t element, bool active)
{
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    switch (robot->layout->elements[element].kind) {
    case MOM_RSP_EFFECTOR:
        if (!active)
            mom_rsp_make_safe(robot, element);
        break;
    case MOM_RSP_COMMAND:
    case MOM_RSP_MEMORY_COMMAND:
        /* The middle has withdrawn what was under way, and a packet that had it is behind the barrier. */
        if (!active)
            cell->id = cell->count = 0;
        break;
    case MOM_RSP_SENSOR:
    case MOM_RSP_MONITOR:
        mom_rsp_unflag(cell, MOM_RSP_SENT | MOM_RSP_ASKED);
        mom_rsp_flag(cell, MOM_RSP_NEW);
        break;
    default:
        break;
    }
    if (robot->body->active != NULL)
        robot->body->active(robot->self, element, active);
}

/* Activates or deactivates an element by itself; a module with all its members. */
static void activate(struct mom_rsp_robot *robot, uint8_t element, bool active)
{
    struct mom_rsp_cell *cells = robot->memory.cells;
    bool was = mom_rsp_is_active(robot, element);
    if (mom_rsp_is(&cells[element], MOM_RSP_ACTIVE) == active)
        return;
    cells[element].flags ^= MOM_RSP_ACTIVE;
    if (mom_rsp_is_active(robot, element) != was)
        changed(robot, element, active);
    if (robot->layout->elements[element].kind != MOM_RSP_MODULE)
        return;
    for (size_t i = 0; i < robot->layout->count; i++)
        if (robot->layout->elements[i].module == element && mom_rsp_is(&cells[i], MOM_RSP_ACTIVE))
            changed(robot, (uint8_t)i, active);
}

/* ---- Maps and payloads ---- */

/* What one bit of a device map that is 1 carries. */
enum item_kind { VALUE, ASK, CALL, ACK, ACTIVATE };

struct item {
    enum item_kind kind;
    uint8_t element;
    uint8_t id;
    const uint8_t *data;
    size_t size;
};

/* A body, while its items are read. */
struct items {
    const uint8_t *map;
    const uint8_t *payload;
    size_t place, left;
};

static bool take(struct items *items, size_t size, const uint8_t **taken)
{
    if (items->left < size)
        return false;
    *taken = items->payload;
    items->payload += size;
    items->left -= size;
    return true;
}

static bool take_id(struct items *items, struct item *item, bool may_be_0)
{
    const uint8_t *id;
    if (!take(items, 1, &id) || (id[0] == 0 && !may_be_0))
        return false;
    item->id = id[0];
    return true;
}

static bool take_data(struct items *items, const struct mom_rsp_element *of, struct item *item)
{
    const uint8_t *count;
    item->size = mom_rsp_size(of);
    if (of->type == MOM_RSP_BYTES) {
        if (!take(items, 2, &count))
            return false;
        item->size = mom_rsp_get_16(count);
    }
    return mom_rsp_takes(of, item->size) && take(items, item->size, &item->data);
}

/* Takes the item of an element from the front of a payload. */
static bool take_item(struct items *items, const struct mom_rsp_element *of, struct item *item)
{
    switch (of->kind) {
    case MOM_RSP_EFFECTOR:
        item->kind = VALUE;
        return take_data(items, of, item) && mom_rsp_is_finite(of, item->data, item->size);
    case MOM_RSP_SENSOR:
    case MOM_RSP_MONITOR:
        item->kind = ASK;
        return true;
    case MOM_RSP_COMMAND:
    case MOM_RSP_MEMORY_COMMAND:
        item->kind = CALL;
        return take_id(items, item, false) && take_data(items, of, item);
    case MOM_RSP_EVENT:
    case MOM_RSP_MEMORY_EVENT:
        item->kind = ACK;
        return take_id(items, item, of->kind == MOM_RSP_MEMORY_EVENT);
    default:
        item->kind = ACTIVATE;
        return true;
    }
}

static bool bit(const uint8_t *map, size_t place)
{
    return (map[place / 8] >> (7 - place % 8) & 1) != 0;
}

/* The next item: false at the end, or where the body is wrong, as `outcome` says. */
static bool next_item(const struct mom_rsp_layout *layout, struct items *items, struct item *item, enum mom_rsp_outcome *outcome)
{
    *outcome = MOM_RSP_ACCEPTED;
    for (; items->place < 8 * mom_rsp_map_size(layout); items->place++) {
        if (!bit(items->map, items->place))
            continue;
        if (items->place >= layout->count) {
            *outcome = MOM_RSP_DROPPED_MAP;
            return false;
        }
        *item = (struct item){ .element = (uint8_t)items->place };
        if (!take_item(items, &layout->elements[items->place], item)) {
            *outcome = MOM_RSP_DROPPED_PAYLOAD;
            return false;
        }
        items->place++;
        return true;
    }
    return false;
}

/* Whether a body is right as a whole: no item comes out of one that is wrong anywhere. */
static enum mom_rsp_outcome begin_items(const struct mom_rsp_layout *layout, struct items *items, const uint8_t *body, size_t size)
{
    size_t map_size = mom_rsp_map_size(layout);
    enum mom_rsp_outcome outcome;
    struct item item;
    if (size < map_size)
        return MOM_RSP_DROPPED_MAP;
    *items = (struct items){ .map = body, .payload = body + map_size, .left = size - map_size };
    struct items check = *items;
    while (next_item(layout, &check, &item, &outcome)) {}
    if (outcome == MOM_RSP_ACCEPTED && check.left > 0)
        return MOM_RSP_DROPPED_PAYLOAD;
    return outcome;
}

/* ---- Data packets ---- */

/* The newest data packet that the middle has: the values in it are acknowledged. */
static void acknowledge(struct mom_rsp_robot *robot, uint16_t last)
{
    if (mom_rsp_is_newer(last, (uint16_t)(robot->traffic.next - 1)))
        return;
    for (size_t i = 0; i < robot->layout->count; i++) {
        struct mom_rsp_cell *cell = &robot->memory.cells[i];
        uint8_t kind = robot->layout->elements[i].kind;
        bool is_value = kind == MOM_RSP_SENSOR || kind == MOM_RSP_MONITOR;
        if (is_value && mom_rsp_is(cell, MOM_RSP_SENT) && !mom_rsp_is_newer(cell->first, last))
            mom_rsp_unflag(cell, MOM_RSP_SENT);
    }
}

/* Executes a command that was not executed yet, and has its id acknowledged. */
static void execute(struct mom_rsp_robot *robot, const struct item *call, bool is_newest)
{
    struct mom_rsp_cell *cell = &robot->memory.cells[call->element];
    if (is_newest)
        activate(robot, call->element, true);
    if (!mom_rsp_is_active(robot, call->element))
        return;
    /* Ids go from 1 to 255 and on with 1. What is older than the last one is late: it was acknowledged, or given up. */
    int ahead = ((int)call->id - cell->id + 255) % 255;
    if (cell->id == 0 || (ahead >= 1 && ahead <= 127)) {
        cell->id = cell->count = call->id;
        if (robot->body->command != NULL)
            robot->body->command(robot->self, call->element, call->data, call->size);
    } else if (ahead == 0) {
        cell->count = call->id;
    }
}

/* The middle has an event, or asks for what is held. */
static void hear_ack(struct mom_rsp_robot *robot, uint8_t element, uint8_t id)
{
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    for (size_t i = 0; i < robot->memory.buffer_count; i++) {
        struct mom_rsp_buffer *buffer = &robot->memory.buffers[i];
        if (buffer->order == 0 || buffer->element != element || buffer->id == 0)
            continue;
        if (id == 0) {
            buffer->waits = true;
        } else if (buffer->id == id) {
            buffer->order = 0;
            return;
        }
    }
    bool is_event = robot->layout->elements[element].kind == MOM_RSP_EVENT;
    if (is_event && cell->count > 0 && mom_rsp_is(cell, MOM_RSP_SENT) && cell->id == id) {
        cell->head = (uint8_t)((cell->head + 1) % MOM_RSP_EVENTS);
        cell->count--;
        mom_rsp_unflag(cell, MOM_RSP_SENT);
    }
}

static void hear_item(struct mom_rsp_robot *robot, uint64_t now, uint64_t full, const struct item *item, bool is_newest)
{
    /* A late packet moves nothing, but its ids and acknowledgements count: they do so once anyway. Only a call that a control has overtaken
     * counts as lost: it may have been withdrawn. */
    if (item->kind == CALL) {
        if (full >= robot->barrier)
            execute(robot, item, is_newest);
        return;
    }
    if (item->kind == ACK && item->id != 0) {
        hear_ack(robot, item->element, item->id);
        return;
    }
    if (!is_newest)
        return;
    if (item->kind == ACK) {
        hear_ack(robot, item->element, 0);
        return;
    }
    activate(robot, item->element, true);
    if (item->kind == ASK)
        mom_rsp_flag(&robot->memory.cells[item->element], MOM_RSP_ASKED);
    else if (item->kind == VALUE && mom_rsp_is_active(robot, item->element))
        mom_rsp_hear_value(robot, now, item->element, item->data, item->size);
}

static enum mom_rsp_outcome hear_data(struct mom_rsp_robot *robot, uint64_t now, uint64_t full, const struct mom_rsp_header *header,
                                      const uint8_t *body, size_t size)
{
    struct items items;
    struct item item;
    enum mom_rsp_outcome outcome = begin_items(robot->layout, &items, body, size);
    if (outcome != MOM_RSP_ACCEPTED)
        return outcome;
    bool is_newest = full >= robot->floor;
    if (is_newest) {
        robot->floor = full + 1;
        robot->fed = now;
        robot->traffic.has_data = true;
        robot->traffic.data = full;
        acknowledge(robot, header->last);
        if (header->buffers != robot->cleared) {
            robot->cleared = header->buffers;
            mom_rsp_free_all(robot);
        }
    }
    while (next_item(robot->layout, &items, &item, &outcome))
        hear_item(robot, now, full, &item, is_newest);
    return MOM_RSP_ACCEPTED;
}

/* ---- Control, fragments and end ---- */

static void obey_control(struct mom_rsp_robot *robot, uint64_t now, uint64_t full, uint16_t period, const uint8_t *map)
{
    /* Data packets that this one has overtaken speak of what was active before: they are late. */
    if (robot->floor < full + 1)
        robot->floor = full + 1;
    robot->barrier = full + 1;
    if (period != robot->period) {
        robot->period = period;
        uint64_t latest = now + mom_rsp_period_us(robot);
        if (robot->next > latest)
            robot->next = latest;
        if (robot->due != MOM_RSP_NEVER && robot->due > latest)
            robot->due = latest;
    }
    for (size_t i = 0; i < robot->layout->count; i++)
        activate(robot, (uint8_t)i, bit(map, i));
}

static enum mom_rsp_outcome hear_control(struct mom_rsp_robot *robot, uint64_t now, uint64_t full, const uint8_t *body, size_t size)
{
    size_t map_size = mom_rsp_map_size(robot->layout);
    if (size < 3)
        return MOM_RSP_DROPPED_PAYLOAD;
    const uint8_t *map = body + 3;
    uint16_t period = mom_rsp_get_16(body + 1);
    if (size - 3 != map_size)
        return MOM_RSP_DROPPED_MAP;
    for (size_t i = robot->layout->count; i < 8 * map_size; i++)
        if (bit(map, i))
            return MOM_RSP_DROPPED_MAP;
    if (period < 1 || period > 200)
        return MOM_RSP_DROPPED_PAYLOAD;
    if (robot->has_control && full < robot->control)
        return MOM_RSP_ACCEPTED;
    if (!robot->has_control || robot->number != body[0])
        obey_control(robot, now, full, period, map);
    robot->has_control = true;
    robot->control = full;
    robot->number = body[0];
    robot->answers_control = true;
    return MOM_RSP_ACCEPTED;
}

static enum mom_rsp_outcome hear_fragment(struct mom_rsp_robot *robot, uint64_t full, const uint8_t *body, size_t size)
{
    if (size < 11)
        return MOM_RSP_DROPPED_PAYLOAD;
    struct mom_rsp_fragment fragment = {
        .element = body[0],
        .blob = mom_rsp_get_16(body + 1),
        .offset = mom_rsp_get_32(body + 3),
        .total = mom_rsp_get_32(body + 7),
        .bytes = body + 11
    };
    size -= 11;
    if (fragment.total < fragment.offset || fragment.offset % MOM_RSP_FRAGMENT != 0 || size == 0)
        return MOM_RSP_DROPPED_PAYLOAD;
    uint32_t rest = fragment.total - fragment.offset;
    if (size != (rest < MOM_RSP_FRAGMENT ? rest : MOM_RSP_FRAGMENT))
        return MOM_RSP_DROPPED_PAYLOAD;
    fragment.size = (uint16_t)size;
    if (full < robot->barrier)
        return MOM_RSP_ACCEPTED;
    if (fragment.element >= robot->layout->count || robot->layout->elements[fragment.element].kind != MOM_RSP_EFFECTOR)
        return MOM_RSP_DROPPED_PAYLOAD;
    if (mom_rsp_is_active(robot, fragment.element) && robot->body->fragment != NULL)
        robot->body->fragment(robot->self, &fragment);
    return MOM_RSP_ACCEPTED;
}

static enum mom_rsp_outcome hear_end(struct mom_rsp_robot *robot, size_t size)
{
    if (size > 0)
        return MOM_RSP_DROPPED_PAYLOAD;
    /* An end that answers one's own needs no answer, or two ends would answer each other for ever. */
    robot->answers_end = !robot->is_ender;
    if (robot->phase == MOM_RSP_UP)
        mom_rsp_over(robot);
    robot->phase = MOM_RSP_DOWN;
    return MOM_RSP_ACCEPTED;
}

static enum mom_rsp_outcome hear(struct mom_rsp_robot *robot, uint64_t now, uint64_t full, const struct mom_rsp_header *header,
                                 const uint8_t *body, size_t size)
{
    if (header->type == MOM_RSP_END)
        return hear_end(robot, size);
    if (robot->phase != MOM_RSP_UP)
        return MOM_RSP_DROPPED_SESSION;
    if (header->type == MOM_RSP_DATA)
        return hear_data(robot, now, full, header, body, size);
    if (header->type == MOM_RSP_CONTROL)
        return hear_control(robot, now, full, body, size);
    return hear_fragment(robot, full, body, size);
}

/* ---- Sessions ---- */

/* The first packet of a session that was given: it begins, and another one is over. */
static enum mom_rsp_outcome hear_first(struct mom_rsp_robot *robot, uint64_t now, const struct mom_rsp_header *header, uint8_t *datagram,
                                       size_t size)
{
    struct mom_rsp_traffic traffic;
    uint64_t full;
    if (!robot->pending.waits || memcmp(robot->pending.session, header->session, sizeof header->session) != 0)
        return MOM_RSP_DROPPED_SESSION;
    mom_rsp_begin_traffic(&traffic, robot);
    enum mom_rsp_outcome outcome = mom_rsp_open(&traffic, robot->cipher, header, datagram, &size, &full);
    if (outcome == MOM_RSP_ACCEPTED) {
        if (robot->phase == MOM_RSP_UP)
            mom_rsp_over(robot);
        robot->traffic = traffic;
        robot->phase = MOM_RSP_UP;
        robot->paper = robot->pending.paper;
        robot->period = robot->pending.period;
        mom_rsp_wipe(&robot->pending, sizeof robot->pending);
        robot->next = robot->fed = now;
        robot->floor = robot->barrier = 0;
        robot->has_control = false;
        robot->cleared = 0;
        robot->answers_control = robot->answers_end = robot->is_ender = false;
        if (robot->body->session != NULL)
            robot->body->session(robot->self, true);
        outcome = hear(robot, now, full, header, datagram + MOM_RSP_HEADER, size - MOM_RSP_HEADER);
    }
    mom_rsp_wipe(&traffic, sizeof traffic);
    return outcome;
}

/* Why a right hello gets no session: the reason of the refusal, 0 for none. */
static uint8_t reason_of(const struct mom_rsp_robot *robot, uint64_t now, const struct mom_rsp_header *header, const uint8_t *hash,
                         enum mom_rsp_outcome *outcome)
{
    if (header->version != 1) {
        *outcome = MOM_RSP_DROPPED_VERSION;
        return MOM_RSP_OTHER_VERSION;
    }
    if (memcmp(hash, robot->layout->hash, 32) != 0 || header->model != robot->layout->id) {
        *outcome = MOM_RSP_DROPPED_MODEL;
        return MOM_RSP_OTHER_MODEL;
    }
    bool alive = robot->phase == MOM_RSP_UP && (mom_rsp_is_watched(robot) || mom_rsp_since(now, robot->fed) < ALIVE);
    *outcome = alive ? MOM_RSP_DROPPED_BUSY : MOM_RSP_ACCEPTED;
    return alive ? MOM_RSP_BUSY : 0;
}

/* A session is given; the same hello again has the same answer. */
static void give_session(struct mom_rsp_robot *robot, const uint8_t *hello, uint16_t period, bool paper)
{
    struct mom_rsp_pending *pending = &robot->pending;
    if (!pending->waits || memcmp(pending->hello, hello, MOM_RSP_NONCE) != 0) {
        memcpy(pending->hello, hello, MOM_RSP_NONCE);
        pending->waits = true;
        pending->period = period;
        pending->paper = paper;
        robot->body->random(robot->self, pending->welcome, sizeof pending->welcome);
        robot->body->random(robot->self, pending->session, sizeof pending->session);
    }
    robot->answers_welcome = true;
}

/* A middle asks for a session. */
static enum mom_rsp_outcome hear_hello(struct mom_rsp_robot *robot, uint64_t now, const struct mom_rsp_header *header,
                                       const uint8_t *datagram, size_t size)
{
    const uint8_t *hello = datagram + MOM_RSP_HEADER;
    enum mom_rsp_outcome outcome = mom_rsp_checked(robot, header, datagram, &size);
    if (outcome != MOM_RSP_ACCEPTED)
        return outcome;
    if (size != MOM_RSP_HEADER + 51)
        return MOM_RSP_DROPPED_PAYLOAD;
    uint16_t period = mom_rsp_get_16(hello + 48);
    if (hello[50] > 1 || period < 1 || period > 200)
        return MOM_RSP_DROPPED_PAYLOAD;
    mom_rsp_watch(robot, now);
    uint64_t second = now / 1000000;
    if (robot->second != second) {
        robot->second = second;
        robot->answered = 0;
    }
    if (robot->answered >= ANSWERS)
        return MOM_RSP_DROPPED_FLOOD;
    robot->answered++;
    uint8_t reason = reason_of(robot, now, header, hello + 16, &outcome);
    if (reason != 0) {
        robot->refusal = reason;
        memcpy(robot->refused, hello, sizeof robot->refused);
        return outcome;
    }
    give_session(robot, hello, period, hello[50] == 1);
    return MOM_RSP_ACCEPTED;
}

/* ---- Any datagram ---- */

static enum mom_rsp_outcome hear_any(struct mom_rsp_robot *robot, uint64_t now, uint8_t *datagram, size_t size)
{
    struct mom_rsp_header header;
    uint64_t full;
    enum mom_rsp_outcome outcome = mom_rsp_header_decode(&header, datagram, size);
    if (outcome != MOM_RSP_ACCEPTED)
        return outcome;
    if (header.type > MOM_RSP_END)
        return MOM_RSP_DROPPED_TYPE;
    if (header.type == MOM_RSP_HELLO)
        return hear_hello(robot, now, &header, datagram, size);
    if (header.version != 1)
        return MOM_RSP_DROPPED_VERSION;
    if (header.model != robot->layout->id)
        return MOM_RSP_DROPPED_MODEL;
    mom_rsp_watch(robot, now);
    if (!robot->traffic.known || memcmp(robot->traffic.session, header.session, sizeof header.session) != 0)
        return hear_first(robot, now, &header, datagram, size);
    outcome = mom_rsp_open(&robot->traffic, robot->cipher, &header, datagram, &size, &full);
    if (outcome != MOM_RSP_ACCEPTED)
        return outcome;
    return hear(robot, now, full, &header, datagram + MOM_RSP_HEADER, size - MOM_RSP_HEADER);
}

enum mom_rsp_outcome mom_rsp_receive(struct mom_rsp_robot *robot, uint64_t now, uint8_t *datagram, size_t size)
{
    enum mom_rsp_outcome outcome = hear_any(robot, now, datagram, size);
    if (robot->counters[outcome] < UINT32_MAX)
        robot->counters[outcome]++;
    return outcome;
}
