/* A robot's state: what its program tells, what is active, and how a session is over. */
#include <string.h>

#include "mom_rsp_internal.h"

/* For how long an end is said, µs. */
#define FAREWELL 500000u

/* ---- What a layout needs ---- */

/*
 * The bytes that an element has among the values. An effector of numbers has three parts: its newest value, its last output, and where it
 * came from; an incremental one the total that was heard, the total that was put out, and its step. One of bytes has its value, a sensor
 * has one, an event as many as can wait.
 */
size_t mom_rsp_element_bytes(const struct mom_rsp_element *of)
{
    switch (of->kind) {
    case MOM_RSP_EFFECTOR:
        return mom_rsp_is_number(of->type) ? 3 * mom_rsp_size(of) : mom_rsp_size(of);
    case MOM_RSP_SENSOR:
    case MOM_RSP_MONITOR:
        return mom_rsp_size(of);
    case MOM_RSP_EVENT:
        return MOM_RSP_EVENTS * mom_rsp_size(of);
    default:
        return 0;
    }
}

size_t mom_rsp_values(const struct mom_rsp_layout *layout)
{
    size_t sum = 0;
    for (size_t i = 0; i < layout->count; i++)
        sum += mom_rsp_element_bytes(&layout->elements[i]);
    return sum;
}

size_t mom_rsp_slot(const struct mom_rsp_layout *layout)
{
    size_t most = 0;
    for (size_t i = 0; i < layout->count; i++) {
        const struct mom_rsp_element *of = &layout->elements[i];
        size_t size = of->type == MOM_RSP_BYTES ? of->count : mom_rsp_size(of);
        if (of->kind == MOM_RSP_MEMORY_EVENT && size > most)
            most = size;
    }
    return most;
}

static size_t down_size(const struct mom_rsp_element *of)
{
    switch (of->kind) {
    case MOM_RSP_EFFECTOR:
        return mom_rsp_size(of);
    case MOM_RSP_COMMAND:
    case MOM_RSP_MEMORY_COMMAND:
        return 1 + mom_rsp_size(of);
    case MOM_RSP_EVENT:
    case MOM_RSP_MEMORY_EVENT:
        return 1;
    default:
        return 0;
    }
}

static size_t up_size(const struct mom_rsp_element *of)
{
    switch (of->kind) {
    case MOM_RSP_SENSOR:
    case MOM_RSP_MONITOR:
        return mom_rsp_size(of);
    case MOM_RSP_COMMAND:
    case MOM_RSP_MEMORY_COMMAND:
        return 1;
    case MOM_RSP_EVENT:
        return 1 + mom_rsp_size(of);
    case MOM_RSP_MEMORY_EVENT:
        return 3 + (of->type == MOM_RSP_BYTES ? (size_t)of->count : mom_rsp_size(of));
    default:
        return 0;
    }
}

/* The most bytes of a data packet up, sealed. */
size_t mom_rsp_largest_up(const struct mom_rsp_layout *layout)
{
    size_t sum = MOM_RSP_HEADER + mom_rsp_map_size(layout) + MOM_RSP_TAG;
    for (size_t i = 0; i < layout->count; i++)
        sum += up_size(&layout->elements[i]);
    return sum;
}

size_t mom_rsp_largest(const struct mom_rsp_layout *layout)
{
    size_t most = MOM_RSP_HEADER + 11 + MOM_RSP_FRAGMENT + MOM_RSP_TAG;
    size_t up = mom_rsp_largest_up(layout);
    size_t down = MOM_RSP_HEADER + mom_rsp_map_size(layout) + MOM_RSP_TAG;
    for (size_t i = 0; i < layout->count; i++)
        down += down_size(&layout->elements[i]);
    most = up > most ? up : most;
    return down > most ? down : most;
}

static bool is_sound_effector(const struct mom_rsp_element *of)
{
    bool limited = of->rate != 0.0f;
    if (of->safe == NULL || of->motion > MOM_RSP_INCREMENTAL || !(of->rate >= 0.0f && of->rate <= 3.4028235e38f))
        return false;
    if (of->type != MOM_RSP_BYTES)
        return of->safe_size == mom_rsp_size(of);
    return !limited && of->motion == MOM_RSP_ABSOLUTE && of->safe_size >= 2 && of->safe_size <= mom_rsp_size(of)
           && of->safe_size - 2 == mom_rsp_get_16(of->safe);
}

/* Whether packets can be made by a layout. Generated ones are such; one that is written by hand may not be. */
static bool is_sound(const struct mom_rsp_layout *layout)
{
    if (layout->elements == NULL || layout->count == 0 || layout->count > 256)
        return false;
    for (size_t i = 0; i < layout->count; i++) {
        const struct mom_rsp_element *of = &layout->elements[i];
        if (of->kind > MOM_RSP_MEMORY_EVENT || of->type > MOM_RSP_BYTES || of->name == NULL)
            return false;
        size_t name = strlen(of->name);
        if (name == 0 || name > 255)
            return false;
        if (of->kind == MOM_RSP_MODULE && (mom_rsp_size(of) > 0 || of->module != MOM_RSP_NO_MODULE))
            return false;
        if (of->kind <= MOM_RSP_MONITOR && mom_rsp_size(of) == 0)
            return false;
        if (of->module != MOM_RSP_NO_MODULE
            && (of->module < 0 || of->module >= layout->count || layout->elements[of->module].kind != MOM_RSP_MODULE))
            return false;
        if (of->kind == MOM_RSP_EFFECTOR && !is_sound_effector(of))
            return false;
    }
    return mom_rsp_largest(layout) <= 65507 && mom_rsp_values(layout) <= UINT16_MAX;
}

/* ---- The state of a robot ---- */

/* The bytes of an element among the values. */
uint8_t *mom_rsp_bytes(struct mom_rsp_robot *robot, uint8_t element)
{
    return robot->memory.values + robot->memory.cells[element].start;
}

/* Writes data as on the wire: of type bytes their number goes before them. */
void mom_rsp_store(const struct mom_rsp_element *of, uint8_t *to, const uint8_t *data, size_t size)
{
    if (of->type == MOM_RSP_BYTES) {
        mom_rsp_put_16(to, (uint16_t)size);
        to += 2;
    }
    if (size > 0)
        memcpy(to, data, size);
}

/* The data that mom_rsp_store wrote. */
const uint8_t *mom_rsp_stored(const struct mom_rsp_element *of, const uint8_t *from, size_t *size)
{
    if (of->type == MOM_RSP_BYTES) {
        *size = mom_rsp_get_16(from);
        return from + 2;
    }
    *size = mom_rsp_size(of);
    return from;
}

static enum mom_rsp_fault fault_of(const struct mom_rsp_layout *layout, const struct mom_rsp_settings *settings,
                                   const struct mom_rsp_memory *memory, const struct mom_rsp_body *body)
{
    if (!is_sound(layout))
        return MOM_RSP_FAULT_LAYOUT;
    if (memory->cell_count != layout->count)
        return MOM_RSP_FAULT_ELEMENTS;
    if (memory->value_size < mom_rsp_values(layout))
        return MOM_RSP_FAULT_VALUES;
    if (memory->buffer_count > 255 || memory->held_size < memory->buffer_count * mom_rsp_slot(layout))
        return MOM_RSP_FAULT_BUFFERS;
    if (settings->key != NULL && settings->cipher == NULL)
        return MOM_RSP_FAULT_CIPHER;
    if (body->random == NULL || body->effector == NULL)
        return MOM_RSP_FAULT_BODY;
    return MOM_RSP_FINE;
}

enum mom_rsp_fault mom_rsp_init(struct mom_rsp_robot *robot, const struct mom_rsp_layout *layout, const struct mom_rsp_settings *settings,
                                const struct mom_rsp_memory *memory, const struct mom_rsp_body *body, void *self)
{
    enum mom_rsp_fault fault = fault_of(layout, settings, memory, body);
    if (fault != MOM_RSP_FINE)
        return fault;
    memset(robot, 0, sizeof *robot);
    robot->layout = layout;
    robot->body = body;
    robot->self = self;
    robot->memory = *memory;
    robot->cipher = settings->cipher;
    robot->watchdog = settings->watchdog;
    robot->budget = settings->budget;
    robot->slot = (uint16_t)mom_rsp_slot(layout);
    robot->period = 200;
    robot->due = MOM_RSP_NEVER;
    robot->keyed = settings->key != NULL;
    if (robot->keyed)
        memcpy(robot->key, settings->key, sizeof robot->key);
    memset(memory->values, 0, mom_rsp_values(layout));
    mom_rsp_free_all(robot);
    size_t start = 0;
    for (size_t i = 0; i < layout->count; i++) {
        struct mom_rsp_cell *cell = &memory->cells[i];
        memset(cell, 0, sizeof *cell);
        cell->flags = MOM_RSP_ACTIVE;
        cell->start = (uint16_t)start;
        start += mom_rsp_element_bytes(&layout->elements[i]);
        if (layout->elements[i].kind == MOM_RSP_EFFECTOR)
            mom_rsp_rest(&layout->elements[i], memory->values + cell->start);
    }
    return MOM_RSP_FINE;
}

/* Frees all buffers of memory events. */
void mom_rsp_free_all(struct mom_rsp_robot *robot)
{
    for (size_t i = 0; i < robot->memory.buffer_count; i++)
        robot->memory.buffers[i].order = 0;
}

enum mom_rsp_refused mom_rsp_set(struct mom_rsp_robot *robot, uint8_t element, const uint8_t *value, size_t size)
{
    if (element >= robot->layout->count)
        return MOM_RSP_REFUSED_ELEMENT;
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    if (of->kind != MOM_RSP_SENSOR && of->kind != MOM_RSP_MONITOR)
        return MOM_RSP_REFUSED_KIND;
    if (!mom_rsp_takes(of, size))
        return MOM_RSP_REFUSED_SIZE;
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    uint8_t *bytes = mom_rsp_bytes(robot, element);
    size_t had;
    const uint8_t *old = mom_rsp_stored(of, bytes, &had);
    bool same = mom_rsp_is(cell, MOM_RSP_HAS) && had == size && (size == 0 || memcmp(old, value, size) == 0);
    if (!same) {
        mom_rsp_store(of, bytes, value, size);
        mom_rsp_flag(cell, MOM_RSP_HAS | MOM_RSP_NEW);
    }
    return MOM_RSP_DONE;
}

static enum mom_rsp_refused raise_event(struct mom_rsp_robot *robot, uint8_t element, const uint8_t *data, size_t size)
{
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    struct mom_rsp_cell *cell = &robot->memory.cells[element];
    if (!mom_rsp_is_up(robot))
        return MOM_RSP_REFUSED_NO_SESSION;
    if (cell->count >= MOM_RSP_EVENTS)
        return MOM_RSP_REFUSED_FULL;
    size_t place = ((size_t)cell->head + cell->count) % MOM_RSP_EVENTS;
    mom_rsp_store(of, mom_rsp_bytes(robot, element) + place * mom_rsp_size(of), data, size);
    cell->count++;
    return MOM_RSP_DONE;
}

static enum mom_rsp_refused hold_event(struct mom_rsp_robot *robot, uint8_t element, const uint8_t *data, size_t size)
{
    for (size_t i = 0; i < robot->memory.buffer_count; i++) {
        struct mom_rsp_buffer *buffer = &robot->memory.buffers[i];
        if (buffer->order != 0)
            continue;
        if (size > 0)
            memcpy(robot->memory.held + i * robot->slot, data, size);
        robot->order = robot->order == UINT32_MAX ? 1 : robot->order + 1;
        *buffer = (struct mom_rsp_buffer){ .order = robot->order, .size = (uint16_t)size, .element = element, .waits = true };
        return MOM_RSP_DONE;
    }
    return MOM_RSP_REFUSED_FULL;
}

enum mom_rsp_refused mom_rsp_raise(struct mom_rsp_robot *robot, uint8_t element, const uint8_t *data, size_t size)
{
    if (element >= robot->layout->count)
        return MOM_RSP_REFUSED_ELEMENT;
    const struct mom_rsp_element *of = &robot->layout->elements[element];
    if (of->kind != MOM_RSP_EVENT && of->kind != MOM_RSP_MEMORY_EVENT)
        return MOM_RSP_REFUSED_KIND;
    if (!mom_rsp_takes(of, size))
        return MOM_RSP_REFUSED_SIZE;
    if (!mom_rsp_is_active(robot, element))
        return MOM_RSP_REFUSED_INACTIVE;
    return of->kind == MOM_RSP_EVENT ? raise_event(robot, element, data, size) : hold_event(robot, element, data, size);
}

void mom_rsp_end(struct mom_rsp_robot *robot, uint64_t now)
{
    if (robot->phase != MOM_RSP_UP)
        return;
    mom_rsp_over(robot);
    robot->phase = MOM_RSP_ENDING;
    robot->is_ender = true;
    robot->fed = now;
    robot->next = now;
}

static void tell_unknown(struct mom_rsp_robot *robot, uint8_t element)
{
    if (robot->body->unknown != NULL)
        robot->body->unknown(robot->self, element);
}

/* The session is over: safe values, and what was said of events is forgotten. */
void mom_rsp_over(struct mom_rsp_robot *robot)
{
    robot->phase = MOM_RSP_DOWN;
    robot->due = MOM_RSP_NEVER;
    for (size_t i = 0; i < robot->layout->count; i++) {
        struct mom_rsp_cell *cell = &robot->memory.cells[i];
        uint8_t kind = robot->layout->elements[i].kind;
        uint8_t lost = kind == MOM_RSP_EVENT ? cell->count : 0;
        unsigned has = mom_rsp_is(cell, MOM_RSP_HAS) ? MOM_RSP_HAS | MOM_RSP_NEW : 0;
        *cell = (struct mom_rsp_cell){ .start = cell->start, .flags = (uint8_t)(MOM_RSP_ACTIVE | has) };
        if (kind == MOM_RSP_EFFECTOR)
            mom_rsp_make_safe(robot, (uint8_t)i);
        while (lost-- > 0)
            tell_unknown(robot, (uint8_t)i);
    }
    for (size_t i = 0; i < robot->memory.buffer_count; i++) {
        struct mom_rsp_buffer *buffer = &robot->memory.buffers[i];
        /* What was never sent waits for the next session. */
        if (buffer->order != 0 && buffer->id != 0) {
            buffer->order = 0;
            tell_unknown(robot, buffer->element);
        }
    }
    if (robot->body->session != NULL)
        robot->body->session(robot->self, false);
}

/* The watchdog: a silent middle commands nothing. */
void mom_rsp_watch(struct mom_rsp_robot *robot, uint64_t now)
{
    uint64_t silent = mom_rsp_since(now, robot->fed);
    if (robot->phase == MOM_RSP_UP && mom_rsp_is_watched(robot) && silent >= (uint64_t)robot->watchdog * 1000)
        mom_rsp_over(robot);
    else if (robot->phase == MOM_RSP_ENDING && silent >= FAREWELL)
        robot->phase = MOM_RSP_DOWN;
}

bool mom_rsp_is_up(const struct mom_rsp_robot *robot)
{
    return robot->phase == MOM_RSP_UP;
}

bool mom_rsp_is_active(const struct mom_rsp_robot *robot, uint8_t element)
{
    if (element >= robot->layout->count || !mom_rsp_is(&robot->memory.cells[element], MOM_RSP_ACTIVE))
        return false;
    int16_t module = robot->layout->elements[element].module;
    return module == MOM_RSP_NO_MODULE || mom_rsp_is(&robot->memory.cells[module], MOM_RSP_ACTIVE);
}

uint8_t mom_rsp_free_buffers(const struct mom_rsp_robot *robot)
{
    uint8_t count = 0;
    for (size_t i = 0; i < robot->memory.buffer_count; i++)
        if (robot->memory.buffers[i].order == 0)
            count++;
    return count;
}

uint64_t mom_rsp_deadline(const struct mom_rsp_robot *robot)
{
    bool watches = mom_rsp_is_up(robot) && mom_rsp_is_watched(robot);
    return watches ? robot->fed + (uint64_t)robot->watchdog * 1000 : MOM_RSP_NEVER;
}

uint64_t mom_rsp_wake(const struct mom_rsp_robot *robot)
{
    if (robot->phase == MOM_RSP_DOWN)
        return MOM_RSP_NEVER;
    if (robot->phase == MOM_RSP_ENDING)
        return robot->next;
    uint64_t wake = robot->next < robot->due ? robot->next : robot->due;
    uint64_t deadline = mom_rsp_deadline(robot);
    return wake < deadline ? wake : deadline;
}

uint16_t mom_rsp_period(const struct mom_rsp_robot *robot)
{
    return robot->period;
}

uint32_t mom_rsp_count(const struct mom_rsp_robot *robot, enum mom_rsp_outcome outcome)
{
    return (unsigned)outcome < MOM_RSP_OUTCOMES ? robot->counters[outcome] : 0;
}

bool mom_rsp_refuses(enum mom_rsp_outcome outcome)
{
    return outcome == MOM_RSP_DROPPED_BUSY || outcome == MOM_RSP_DROPPED_MODEL || outcome == MOM_RSP_DROPPED_VERSION;
}

bool mom_rsp_is_refusal(const uint8_t *datagram, size_t size)
{
    return size >= MOM_RSP_HEADER && datagram[4] == MOM_RSP_REFUSAL;
}
