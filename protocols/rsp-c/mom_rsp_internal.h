/* What the files of the library share; a robot's program includes mom_rsp.h alone. */
#ifndef MOM_RSP_INTERNAL_H
#define MOM_RSP_INTERNAL_H

#include "mom_rsp.h"

#define MOM_RSP_HEADER 20
#define MOM_RSP_TAG 16
#define MOM_RSP_NONCE 16
#define MOM_RSP_EVENTS 4

/* The phases of a robot. */
enum { MOM_RSP_DOWN, MOM_RSP_UP, MOM_RSP_ENDING };

/* The flags of a cell. */
enum {
    MOM_RSP_ACTIVE = 1, /* the element is activated by itself; its module may not be */
    MOM_RSP_HAS = 2,    /* a sensor has a value */
    MOM_RSP_NEW = 4,    /* a sensor's value is in no packet yet; an effector's was not put out yet */
    MOM_RSP_SENT = 8,   /* a sensor's value was sent and is not acknowledged; an event was sent */
    MOM_RSP_ASKED = 16  /* a sensor was asked for */
};

/* The types of packets. */
enum {
    MOM_RSP_HELLO = 0x00,
    MOM_RSP_DATA = 0x01,
    MOM_RSP_CONTROL = 0x02,
    MOM_RSP_FRAGMENT_DOWN = 0x03,
    MOM_RSP_END = 0x04,
    MOM_RSP_WELCOME = 0x80,
    MOM_RSP_UP_DATA = 0x81,
    MOM_RSP_UP_CONTROL = 0x82,
    MOM_RSP_UP_FRAGMENT = 0x83,
    MOM_RSP_UP_END = 0x84,
    MOM_RSP_REFUSAL = 0x85
};

/* The reasons of a refusal. */
enum { MOM_RSP_OTHER_MODEL = 1, MOM_RSP_BUSY = 2, MOM_RSP_OTHER_VERSION = 3 };

struct mom_rsp_header {
    uint8_t version, encryption, type, buffers;
    uint16_t model, sequence, last;
    uint32_t stamp;
    uint8_t session[6];
};

static inline uint16_t mom_rsp_get_16(const uint8_t *from)
{
    return (uint16_t)((unsigned)from[0] << 8 | from[1]);
}

static inline uint32_t mom_rsp_get_32(const uint8_t *from)
{
    return (uint32_t)mom_rsp_get_16(from) << 16 | mom_rsp_get_16(from + 2);
}

static inline void mom_rsp_put_16(uint8_t *to, uint16_t value)
{
    to[0] = (uint8_t)(value >> 8);
    to[1] = (uint8_t)value;
}

static inline void mom_rsp_put_32(uint8_t *to, uint32_t value)
{
    mom_rsp_put_16(to, (uint16_t)(value >> 16));
    mom_rsp_put_16(to + 2, (uint16_t)value);
}

/* Whether `a` comes after `b`, by RFC 1982. */
static inline bool mom_rsp_is_newer(uint16_t a, uint16_t b)
{
    uint16_t ahead = (uint16_t)(a - b);
    return ahead != 0 && ahead < 0x8000;
}

static inline size_t mom_rsp_number_size(uint8_t type)
{
    static const uint8_t sizes[] = { 0, 1, 1, 2, 2, 4, 4, 4, 0 };
    return sizes[type];
}

static inline bool mom_rsp_is_number(uint8_t type)
{
    return type > MOM_RSP_NOTHING && type < MOM_RSP_BYTES;
}

/* The most bytes of an element's data on the wire. */
static inline size_t mom_rsp_size(const struct mom_rsp_element *of)
{
    return of->type == MOM_RSP_BYTES ? 2 + (size_t)of->count : mom_rsp_number_size(of->type) * of->count;
}

/* Whether an element can have so many bytes of data. */
static inline bool mom_rsp_takes(const struct mom_rsp_element *of, size_t size)
{
    return of->type == MOM_RSP_BYTES ? size <= of->count : size == mom_rsp_size(of);
}

static inline bool mom_rsp_is(const struct mom_rsp_cell *cell, unsigned flags)
{
    return (cell->flags & flags) == flags;
}

static inline void mom_rsp_flag(struct mom_rsp_cell *cell, unsigned flags)
{
    cell->flags = (uint8_t)(cell->flags | flags);
}

static inline void mom_rsp_unflag(struct mom_rsp_cell *cell, unsigned flags)
{
    cell->flags = (uint8_t)(cell->flags & ~flags);
}

static inline size_t mom_rsp_map_size(const struct mom_rsp_layout *layout)
{
    return ((size_t)layout->count + 7) / 8;
}

static inline uint64_t mom_rsp_period_us(const struct mom_rsp_robot *robot)
{
    return (uint64_t)robot->period * 1000;
}

static inline uint64_t mom_rsp_since(uint64_t now, uint64_t then)
{
    return now > then ? now - then : 0;
}

static inline bool mom_rsp_is_watched(const struct mom_rsp_robot *robot)
{
    return !robot->paper && robot->watchdog > 0;
}

/* mom_rsp.c */
size_t mom_rsp_element_bytes(const struct mom_rsp_element *of);
uint8_t *mom_rsp_bytes(struct mom_rsp_robot *robot, uint8_t element);
void mom_rsp_store(const struct mom_rsp_element *of, uint8_t *to, const uint8_t *data, size_t size);
const uint8_t *mom_rsp_stored(const struct mom_rsp_element *of, const uint8_t *from, size_t *size);
size_t mom_rsp_largest_up(const struct mom_rsp_layout *layout);
void mom_rsp_free_all(struct mom_rsp_robot *robot);
void mom_rsp_over(struct mom_rsp_robot *robot);
void mom_rsp_watch(struct mom_rsp_robot *robot, uint64_t now);

/* mom_rsp_motion.c */
bool mom_rsp_is_finite(const struct mom_rsp_element *of, const uint8_t *value, size_t size);
void mom_rsp_rest(const struct mom_rsp_element *of, uint8_t *bytes);
void mom_rsp_make_safe(struct mom_rsp_robot *robot, uint8_t element);
void mom_rsp_hear_value(struct mom_rsp_robot *robot, uint64_t now, uint8_t element, const uint8_t *value, size_t size);
void mom_rsp_move_all(struct mom_rsp_robot *robot, uint64_t now);

/* mom_rsp_seal.c */
void mom_rsp_header_encode(const struct mom_rsp_header *from, uint8_t *to);
enum mom_rsp_outcome mom_rsp_header_decode(struct mom_rsp_header *to, const uint8_t *from, size_t size);
enum mom_rsp_outcome mom_rsp_checked(const struct mom_rsp_robot *robot, const struct mom_rsp_header *header, const uint8_t *packet,
                                     size_t *size);
size_t mom_rsp_sign(const struct mom_rsp_robot *robot, uint8_t *packet, size_t room, size_t size);
void mom_rsp_begin_traffic(struct mom_rsp_traffic *traffic, const struct mom_rsp_robot *robot);
enum mom_rsp_outcome mom_rsp_open(struct mom_rsp_traffic *traffic, const struct mom_rsp_cipher *cipher, const struct mom_rsp_header *header,
                                  uint8_t *packet, size_t *size, uint64_t *full);
size_t mom_rsp_close(struct mom_rsp_robot *robot, uint8_t type, uint64_t now, uint8_t *packet, size_t room, size_t size);
void mom_rsp_wipe(void *bytes, size_t size);

#endif /* MOM_RSP_INTERNAL_H */
