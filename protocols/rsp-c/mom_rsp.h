/*
 * The robot's end of RSP, the robot simulacrum protocol, in C99: for a robot with a microcontroller. docs/rsp.md describes the wire.
 *
 * It allocates nothing, has no state of its own, does no IO and has no clock: a program gives it datagrams and times, and gets datagrams
 * and what is to be done. Times are uint64_t, µs of any clock that never goes back. `mom rsp generate --c` writes a header for a model,
 * which has the model's layout, the memory it needs and functions in its types, where this file is included before it.
 *
 * Data are as on the wire: numbers are big-endian, of elements of type bytes there are the bytes without their number.
 */
#ifndef MOM_RSP_LIBRARY_H
#define MOM_RSP_LIBRARY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- The model ---- */

enum mom_rsp_kind {
    MOM_RSP_EFFECTOR,
    MOM_RSP_SENSOR,
    MOM_RSP_MONITOR,
    MOM_RSP_COMMAND,
    MOM_RSP_MODULE,
    MOM_RSP_EVENT,
    MOM_RSP_MEMORY_COMMAND,
    MOM_RSP_MEMORY_EVENT
};

/* What the data of an element are. */
enum mom_rsp_type {
    MOM_RSP_NOTHING,
    MOM_RSP_U8,
    MOM_RSP_I8,
    MOM_RSP_U16,
    MOM_RSP_I16,
    MOM_RSP_U32,
    MOM_RSP_I32,
    MOM_RSP_F32,
    MOM_RSP_BYTES
};

/* What is done with the values of an effector. */
enum mom_rsp_motion {
    MOM_RSP_ABSOLUTE,     /* the newest value counts */
    MOM_RSP_INTERPOLATED, /* the same, on a straight line through one period */
    MOM_RSP_INCREMENTAL   /* values are steps that add up */
};

/* `module` of an element that is a member of none. */
#define MOM_RSP_NO_MODULE (-1)

/* One element of a model, which is one bit of the device map. */
struct mom_rsp_element {
    const char *name;
    uint32_t digest;     /* two ends compare it and name what differs */
    uint8_t kind;        /* enum mom_rsp_kind */
    uint8_t type;        /* enum mom_rsp_type */
    uint16_t count;      /* how many numbers; of type bytes: the most of them */
    uint8_t motion;      /* enum mom_rsp_motion, of an effector */
    float rate;          /* of an effector: the most change a second in units of the wire, 0 for no limit */
    const uint8_t *safe; /* of an effector: its safe value as on the wire, of type bytes with their number */
    uint16_t safe_size;
    uint16_t period;     /* of a sensor or a monitor: it is sent at most so often, in ms; 0 for each packet */
    int16_t module;      /* the place of the module that it is a member of, or MOM_RSP_NO_MODULE */
};

/* The model of a robot, as its packets need it. */
struct mom_rsp_layout {
    uint16_t id;
    uint8_t hash[32];
    uint16_t count; /* elements, 1 to 256 */
    const struct mom_rsp_element *elements;
};

/* What one number of an element means. */
struct mom_rsp_quantity {
    uint8_t type;    /* enum mom_rsp_type */
    double scale;    /* the value in its unit is the number on the wire times this */
    double min, max; /* in its unit */
};

/* The numbers of `from` in their units. `size` quantities say what they mean, one for each number or one for all. Where `limited`, a
 * number outside its range becomes the nearest one within. */
void mom_rsp_decode(const struct mom_rsp_quantity *quantities, size_t size, bool limited, const uint8_t *from, double *to, size_t count);

/* Writes numbers in their units as on the wire; false if one is outside its range. */
bool mom_rsp_encode(const struct mom_rsp_quantity *quantities, size_t size, const double *from, uint8_t *to, size_t count);

/* ---- The cipher ---- */

/* What a session with a key needs. Hardware that has one of these may do it; all may be called with bytes that lie anywhere. */
struct mom_rsp_cipher {
    /* HMAC-SHA256 with a key of 32 bytes. */
    void (*code)(const uint8_t key[32], const uint8_t *bytes, size_t size, uint8_t code[32]);
    /* ChaCha20-Poly1305 (RFC 8439): encrypts `bytes` in place, with `header` (20 bytes) as associated data. */
    void (*seal)(const uint8_t key[32], const uint8_t nonce[12], const uint8_t header[20], uint8_t *bytes, size_t size, uint8_t tag[16]);
    /* Decrypts `bytes` in place; false, with nothing decrypted, if the tag is wrong. The comparison takes the same time for all tags. */
    bool (*open)(const uint8_t key[32], const uint8_t nonce[12], const uint8_t header[20], uint8_t *bytes, size_t size,
                 const uint8_t tag[16]);
};

/* The cipher in portable C, of mom_rsp_crypto.c, which a program without a key need not link. */
extern const struct mom_rsp_cipher mom_rsp_portable_cipher;

/* ---- What the robot's own program gives ---- */

/* The bytes of each fragment of a blob but the last. */
#define MOM_RSP_FRAGMENT 480

/* A part of a blob. */
struct mom_rsp_fragment {
    uint8_t element;
    uint16_t blob;   /* numbers the blobs of an element in one direction */
    uint32_t offset; /* where the part is in the blob: a multiple of MOM_RSP_FRAGMENT */
    uint32_t total;  /* bytes of the whole blob, 1 at least */
    const uint8_t *bytes;
    uint16_t size;   /* MOM_RSP_FRAGMENT, fewer only at the end of the blob */
};

/*
 * The robot's own program. All are called from mom_rsp_receive, mom_rsp_poll and mom_rsp_end, with elements of the right kind and as many
 * bytes as the model says, and may not call these. Those that may be NULL are optional.
 */
struct mom_rsp_body {
    /* Fills the bytes with what nobody can foresee: nonces and sessions are made of it. */
    void (*random)(void *self, uint8_t *bytes, size_t size);
    /* An effector's next value, or the step of an incremental one, at most one each 7/8 period; its safe value at once when nobody
     * commands it. No call means: hold. */
    void (*effector)(void *self, uint8_t element, const uint8_t *value, size_t size);
    /* A command or memory command is to be executed, once. May be NULL. */
    void (*command)(void *self, uint8_t element, const uint8_t *data, size_t size);
    /* A part of a blob is here; parts come in any order and may be lost. May be NULL. */
    void (*fragment)(void *self, const struct mom_rsp_fragment *fragment);
    /* Writes the next part of a blob for the middle into `into` (MOM_RSP_FRAGMENT bytes), and the rest but `bytes` into `fragment`;
     * false if there is none. It is sent as far as the budget of the period goes. May be NULL. */
    bool (*next_fragment)(void *self, struct mom_rsp_fragment *fragment, uint8_t *into);
    /* An element was activated or deactivated. What a deactivated command has begun ends now, as does what a deactivated effector plays:
     * so a robot is stopped. May be NULL. */
    void (*active)(void *self, uint8_t element, bool active);
    /* A session began; or it is over, all effectors have their safe values, and what commands have begun ends now. May be NULL. */
    void (*session)(void *self, bool up);
    /* The session ended before the middle said that an event has arrived. It will not be sent again. May be NULL. */
    void (*unknown)(void *self, uint8_t element);
};

struct mom_rsp_settings {
    const uint8_t *key;                  /* 32 bytes that are shared with the middle and copied; NULL for packets in the open */
    const struct mom_rsp_cipher *cipher; /* needed with a key */
    uint16_t watchdog; /* ms without a newer data packet until the effectors get their safe values; 0 for never. 500 is usual */
    uint16_t budget;   /* bytes of fragments each period at most; 1000 is usual */
};

/* ---- Why something is not done ---- */

/* What became of a datagram: each is counted. */
enum mom_rsp_outcome {
    MOM_RSP_ACCEPTED,
    MOM_RSP_DROPPED_SHORT,
    MOM_RSP_DROPPED_VERSION,
    MOM_RSP_DROPPED_MODEL,
    MOM_RSP_DROPPED_TYPE,
    MOM_RSP_DROPPED_SESSION,
    MOM_RSP_DROPPED_ENCRYPTION,
    MOM_RSP_DROPPED_SEALED,
    MOM_RSP_DROPPED_REPLAYED,
    MOM_RSP_DROPPED_OLD,
    MOM_RSP_DROPPED_MAP,
    MOM_RSP_DROPPED_PAYLOAD,
    MOM_RSP_DROPPED_BUSY,
    MOM_RSP_DROPPED_FLOOD
};
#define MOM_RSP_OUTCOMES 14

/* Whether a request of the robot's own program is done. */
enum mom_rsp_refused {
    MOM_RSP_DONE,
    MOM_RSP_REFUSED_ELEMENT,    /* the model has no such element */
    MOM_RSP_REFUSED_KIND,       /* elements of this kind cannot do that */
    MOM_RSP_REFUSED_SIZE,       /* the bytes are not as many as the model says */
    MOM_RSP_REFUSED_FULL,       /* as many wait as can be held */
    MOM_RSP_REFUSED_NO_SESSION, /* an event needs a session */
    MOM_RSP_REFUSED_INACTIVE,   /* the element is deactivated */
    MOM_RSP_REFUSED_RANGE       /* a number is outside the range of the model */
};

/* Why there can be no robot's end. */
enum mom_rsp_fault {
    MOM_RSP_FINE,
    MOM_RSP_FAULT_LAYOUT,   /* no packets can be made by the layout */
    MOM_RSP_FAULT_ELEMENTS, /* `cells` is not one for each element */
    MOM_RSP_FAULT_VALUES,   /* `values` has too few bytes */
    MOM_RSP_FAULT_BUFFERS,  /* there are more than 255 buffers, or `held` has too few bytes */
    MOM_RSP_FAULT_CIPHER,   /* a key needs a cipher */
    MOM_RSP_FAULT_BODY      /* the body lacks `random` or `effector` */
};

/* ---- The state of a robot; its members are the library's own ---- */

/* The state of one element. */
struct mom_rsp_cell {
    uint16_t start; /* where its bytes begin among the values */
    uint16_t first; /* of a sensor: the sequence of the first packet with this value */
    uint32_t at;    /* of a sensor: when a value was last taken; of an effector: when its value arrived; low bits of µs */
    float credit;   /* of an effector: the change that its rate allows and that was too little for a whole unit */
    uint8_t id;     /* of a command: the last that was executed; of an event: that of the oldest that waits; 0 before */
    uint8_t count;  /* of a command: the id to acknowledge, 0 for none; of an event: how many wait */
    uint8_t head;   /* of an event: the place of the oldest */
    uint8_t flags;
};

/* A buffer for a memory event. */
struct mom_rsp_buffer {
    uint32_t order; /* buffers are used in this order; 0 for a free one */
    uint16_t size;
    uint8_t element;
    uint8_t id; /* 0 until it is sent for the first time */
    bool waits; /* to be sent */
};

/* What a robot's end needs of memory, for as long as it is used: generated headers have it. */
struct mom_rsp_memory {
    struct mom_rsp_cell *cells; /* one for each element */
    uint16_t cell_count;
    uint8_t *values; /* mom_rsp_values of the layout */
    size_t value_size;
    struct mom_rsp_buffer *buffers; /* for memory events, 0 to 255 */
    size_t buffer_count;
    uint8_t *held; /* mom_rsp_slot of the layout for each buffer */
    size_t held_size;
};

struct mom_rsp_traffic {
    uint8_t session[6];
    bool known;    /* there is, or was, such a session */
    bool keyed;
    bool has_data;
    uint64_t next;     /* the sequence of the next packet to be sent, continued to 64 bits */
    uint64_t newest;   /* the newest that was heard */
    uint64_t heard[2]; /* bit n: newest - n was heard; the low bits are in [0] */
    uint64_t data;     /* the newest data packet that counts */
    uint8_t down[32];
    uint8_t up[32];
};

struct mom_rsp_pending {
    bool waits;
    bool paper;
    uint16_t period;
    uint8_t session[6];
    uint8_t hello[16];
    uint8_t welcome[16];
};

struct mom_rsp_robot {
    const struct mom_rsp_layout *layout;
    const struct mom_rsp_body *body;
    void *self;
    const struct mom_rsp_cipher *cipher;
    struct mom_rsp_memory memory;
    struct mom_rsp_traffic traffic;
    struct mom_rsp_pending pending; /* a session that was given, until the first packet of it */
    uint8_t key[32];
    bool keyed;
    bool paper;
    bool is_ender;         /* the session was ended here first */
    uint8_t phase;
    bool answers_welcome, answers_control, answers_end;
    uint8_t refusal;       /* the reason of one that is to be said, 0 for none */
    uint8_t refused[16];   /* the nonce of its hello */
    bool has_control;
    uint8_t number;        /* of the newest control */
    uint8_t cleared;       /* the middle's counter of cleared buffers */
    uint8_t answered;      /* hellos in this second */
    uint16_t watchdog, budget, period;
    uint16_t budget_left;
    uint16_t slot;         /* bytes of a buffer of memory events */
    uint32_t order;        /* the highest of a buffer */
    uint64_t second;       /* in which hellos were answered */
    uint64_t control;      /* the sequence of the newest control */
    uint64_t next;         /* when the data packet is due */
    uint64_t due;          /* when the motion filter has its next output */
    uint64_t moved;        /* when it had its last one */
    uint64_t fed;          /* when the newest data packet arrived */
    uint64_t floor;        /* data packets below this sequence are late */
    uint64_t barrier;      /* calls and fragments below this sequence count no more */
    uint32_t counters[MOM_RSP_OUTCOMES];
};

/* ---- The robot's end ---- */

/* A time that does not come. */
#define MOM_RSP_NEVER UINT64_MAX

/* Bytes for the values of a layout, and for each buffer of memory events. */
size_t mom_rsp_values(const struct mom_rsp_layout *layout);
size_t mom_rsp_slot(const struct mom_rsp_layout *layout);

/* The most bytes of a packet of either direction: what the buffers for datagrams need. */
size_t mom_rsp_largest(const struct mom_rsp_layout *layout);

/* A robot that has no session. Layout, body, cipher and memory are not copied. */
enum mom_rsp_fault mom_rsp_init(struct mom_rsp_robot *robot, const struct mom_rsp_layout *layout, const struct mom_rsp_settings *settings,
                                const struct mom_rsp_memory *memory, const struct mom_rsp_body *body, void *self);

/* A datagram has arrived; it is opened in place. What it asks for is done through the body before this returns. */
enum mom_rsp_outcome mom_rsp_receive(struct mom_rsp_robot *robot, uint64_t now, uint8_t *datagram, size_t size);

/* Does what is due, and writes the next datagram to be sent: its bytes, 0 when there is none for now. To be called until 0 after each
 * mom_rsp_receive and at mom_rsp_wake. `size` is mom_rsp_largest at least: a smaller buffer gets no data packet. */
size_t mom_rsp_poll(struct mom_rsp_robot *robot, uint64_t now, uint8_t *out, size_t size);

/* Whether what mom_rsp_poll wrote goes to where a refused hello came from, and not to the middle of the session. */
bool mom_rsp_is_refusal(const uint8_t *datagram, size_t size);

/* Whether a datagram with this outcome is answered by a refusal, which goes to where it came from. */
bool mom_rsp_refuses(enum mom_rsp_outcome outcome);

/* When mom_rsp_poll has something to do, if nothing arrives before. */
uint64_t mom_rsp_wake(const struct mom_rsp_robot *robot);

/* When the watchdog has all effectors take their safe values, if no data packet comes before: for hardware that stops by itself where
 * the robot's own program stands still. MOM_RSP_NEVER without a session or a watchdog. */
uint64_t mom_rsp_deadline(const struct mom_rsp_robot *robot);

/* A new value of a sensor or a monitor. It is sent if it differs from the last one. */
enum mom_rsp_refused mom_rsp_set(struct mom_rsp_robot *robot, uint8_t element, const uint8_t *value, size_t size);

/* An event or a memory event has happened. Four events of an element can wait, and as many memory events as there are buffers. */
enum mom_rsp_refused mom_rsp_raise(struct mom_rsp_robot *robot, uint8_t element, const uint8_t *data, size_t size);

/* Ends the session: safe values now, and the middle is told until it has heard it. */
void mom_rsp_end(struct mom_rsp_robot *robot, uint64_t now);

bool mom_rsp_is_up(const struct mom_rsp_robot *robot);
/* Whether an element is active, and its module too. */
bool mom_rsp_is_active(const struct mom_rsp_robot *robot, uint8_t element);
/* Buffers for memory events that are free. */
uint8_t mom_rsp_free_buffers(const struct mom_rsp_robot *robot);
/* The time between two data packets, ms; of the last session if there is none. */
uint16_t mom_rsp_period(const struct mom_rsp_robot *robot);
/* How many datagrams had this outcome; a count stays at its highest value. */
uint32_t mom_rsp_count(const struct mom_rsp_robot *robot, enum mom_rsp_outcome outcome);

/* ---- Blobs put together, for robots that want them whole ---- */

/* Puts the blobs of one element together, one at a time, each at most 256 fragments long. */
struct mom_rsp_assembly {
    uint8_t *bytes;
    size_t size;
    uint64_t heard[4];
    uint32_t total;
    uint32_t dropped; /* blobs that were given up because a newer one came, or were too large */
    uint16_t blob;
    uint16_t left;
    bool begun;
};

void mom_rsp_assembly_init(struct mom_rsp_assembly *assembly, uint8_t *bytes, size_t size);
/* Adds a part; true when it was the last that lacked: then the blob is the first `total` of `bytes`, until the next call. */
bool mom_rsp_assembly_push(struct mom_rsp_assembly *assembly, const struct mom_rsp_fragment *fragment);
/* Forgets the blob that was begun and its number: at the beginning of a session. */
void mom_rsp_assembly_clear(struct mom_rsp_assembly *assembly);

#ifdef __cplusplus
}
#endif

#endif /* MOM_RSP_LIBRARY_H */
