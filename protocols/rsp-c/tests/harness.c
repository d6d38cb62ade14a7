/*
 * A robot of any layout for tests: reads lines that say what happens to it, and prints what it does. The tests of mom-rsp have the same
 * done by the end in Rust, and compare.
 *
 *   layout ID HASH COUNT
 *   element NAME DIGEST KIND TYPE COUNT MOTION RATE SAFE PERIOD MODULE     RATE is the bits of the float
 *   robot KEY WATCHDOG BUDGET BUFFERS
 *   random BYTES                              what the body's `random` gives next
 *   part ELEMENT BLOB OFFSET TOTAL BYTES      what its `next_fragment` gives next
 *   assembly SIZE | push BLOB OFFSET TOTAL BYTES | clear      puts a blob together, without a robot
 *   receive NOW DATAGRAM | poll NOW ROOM | set ELEMENT VALUE | raise ELEMENT DATA | end NOW | counts
 *
 * Bytes are hexadecimal digits, or `-` for none. All memory is allocated in its exact size, so that sanitizers see what is beyond it.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "mom_rsp.h"

#define LONGEST 400000
#define WAITING 64

static struct mom_rsp_layout layout;
static struct mom_rsp_element *elements;
static struct mom_rsp_robot robot;
static struct mom_rsp_memory memory;

static uint8_t unforeseen[65536];
static size_t unforeseen_from, unforeseen_to;

static struct mom_rsp_assembly assembly;

static struct part {
    struct mom_rsp_fragment head;
    uint8_t *bytes;
} parts[WAITING];
static size_t parts_from, parts_to;

static void fail(const char *why)
{
    fprintf(stderr, "harness: %s\n", why);
    exit(2);
}

static void *allocate(size_t size)
{
    void *bytes = malloc(size > 0 ? size : 1);
    if (bytes == NULL)
        fail("no memory");
    return bytes;
}

static unsigned digit(char c)
{
    return c <= '9' ? (unsigned)(c - '0') : (unsigned)(c - 'a') + 10;
}

/* The bytes of a word. */
static uint8_t *unhex(const char *word, size_t *size)
{
    *size = strcmp(word, "-") == 0 ? 0 : strlen(word) / 2;
    uint8_t *bytes = allocate(*size);
    for (size_t i = 0; i < *size; i++)
        bytes[i] = (uint8_t)(digit(word[2 * i]) << 4 | digit(word[2 * i + 1]));
    return bytes;
}

static void put_hex(const uint8_t *bytes, size_t size)
{
    static const char digits[] = "0123456789abcdef";
    if (size == 0)
        putchar('-');
    for (size_t i = 0; i < size; i++) {
        putchar(digits[bytes[i] >> 4]);
        putchar(digits[bytes[i] & 15]);
    }
}

/* ---- The body ---- */

static void body_random(void *self, uint8_t *bytes, size_t size)
{
    (void)self;
    printf("random %zu\n", size);
    if (unforeseen_to - unforeseen_from < size)
        fail("nothing random is left");
    memcpy(bytes, unforeseen + unforeseen_from, size);
    unforeseen_from += size;
}

static void body_effector(void *self, uint8_t element, const uint8_t *value, size_t size)
{
    (void)self;
    printf("effector %u ", element);
    put_hex(value, size);
    putchar('\n');
}

static void body_command(void *self, uint8_t element, const uint8_t *data, size_t size)
{
    (void)self;
    printf("command %u ", element);
    put_hex(data, size);
    putchar('\n');
}

static void body_fragment(void *self, const struct mom_rsp_fragment *fragment)
{
    (void)self;
    printf("fragment %u %u %lu %lu ", fragment->element, fragment->blob, (unsigned long)fragment->offset, (unsigned long)fragment->total);
    put_hex(fragment->bytes, fragment->size);
    putchar('\n');
}

static bool body_next_fragment(void *self, struct mom_rsp_fragment *fragment, uint8_t *into)
{
    (void)self;
    printf("asked\n");
    if (parts_from == parts_to)
        return false;
    struct part *part = &parts[parts_from++ % WAITING];
    *fragment = part->head;
    memcpy(into, part->bytes, part->head.size);
    free(part->bytes);
    return true;
}

static void body_active(void *self, uint8_t element, bool active)
{
    (void)self;
    printf("active %u %d\n", element, active);
}

static void body_session(void *self, bool up)
{
    (void)self;
    printf("session %d\n", up);
}

static void body_unknown(void *self, uint8_t element)
{
    (void)self;
    printf("unknown %u\n", element);
}

static const struct mom_rsp_body BODY = { body_random, body_effector, body_command,  body_fragment, body_next_fragment,
                                          body_active, body_session,  body_unknown };

/* ---- The lines ---- */

static char *word(void)
{
    char *next = strtok(NULL, " \n");
    if (next == NULL)
        fail("a word lacks");
    return next;
}

static unsigned long long number(void)
{
    return strtoull(word(), NULL, 10);
}

static void read_element(struct mom_rsp_element *to)
{
    size_t size;
    const char *name = word();
    char *kept = allocate(strlen(name) + 1);
    strcpy(kept, name);
    to->name = kept;
    to->digest = (uint32_t)number();
    to->kind = (uint8_t)number();
    to->type = (uint8_t)number();
    to->count = (uint16_t)number();
    to->motion = (uint8_t)number();
    uint32_t rate = (uint32_t)number();
    memcpy(&to->rate, &rate, sizeof to->rate);
    to->safe = unhex(word(), &size);
    to->safe_size = (uint16_t)size;
    to->period = (uint16_t)number();
    to->module = (int16_t)strtol(word(), NULL, 10);
}

static void read_layout(void)
{
    size_t size;
    layout.id = (uint16_t)number();
    uint8_t *hash = unhex(word(), &size);
    memcpy(layout.hash, hash, sizeof layout.hash);
    free(hash);
    elements = allocate((size_t)number() * sizeof *elements);
    layout.elements = elements;
    layout.count = 0;
}

static void begin(void)
{
    size_t size;
    uint8_t *key = unhex(word(), &size);
    struct mom_rsp_settings settings = { size > 0 ? key : NULL, &mom_rsp_portable_cipher, 0, 0 };
    settings.watchdog = (uint16_t)number();
    settings.budget = (uint16_t)number();
    memory.cell_count = layout.count;
    memory.cells = allocate(layout.count * sizeof *memory.cells);
    memory.value_size = mom_rsp_values(&layout);
    memory.values = allocate(memory.value_size);
    memory.buffer_count = (size_t)number();
    memory.buffers = allocate(memory.buffer_count * sizeof *memory.buffers);
    memory.held_size = memory.buffer_count * mom_rsp_slot(&layout);
    memory.held = allocate(memory.held_size);
    if (mom_rsp_init(&robot, &layout, &settings, &memory, &BODY, NULL) != MOM_RSP_FINE)
        fail("there can be no such robot");
    free(key);
    printf("largest %zu\n", mom_rsp_largest(&layout));
}

static void add_random(void)
{
    size_t size;
    uint8_t *bytes = unhex(word(), &size);
    if (unforeseen_from == unforeseen_to)
        unforeseen_from = unforeseen_to = 0;
    if (size > sizeof unforeseen - unforeseen_to)
        fail("too much that is random waits");
    memcpy(unforeseen + unforeseen_to, bytes, size);
    unforeseen_to += size;
    free(bytes);
}

static void add_part(void)
{
    size_t size;
    struct part *part = &parts[parts_to++ % WAITING];
    memset(part, 0, sizeof *part);
    part->head.element = (uint8_t)number();
    part->head.blob = (uint16_t)number();
    part->head.offset = (uint32_t)number();
    part->head.total = (uint32_t)number();
    part->bytes = unhex(word(), &size);
    part->head.size = (uint16_t)size;
}

static void assemble(const char *verb)
{
    size_t size;
    struct mom_rsp_fragment part = { .element = 0 };
    if (strcmp(verb, "assembly") == 0) {
        size = (size_t)number();
        mom_rsp_assembly_init(&assembly, allocate(size), size);
        return;
    }
    if (strcmp(verb, "clear") == 0) {
        mom_rsp_assembly_clear(&assembly);
        printf("= %lu\n", (unsigned long)assembly.dropped);
        return;
    }
    part.blob = (uint16_t)number();
    part.offset = (uint32_t)number();
    part.total = (uint32_t)number();
    uint8_t *bytes = unhex(word(), &size);
    part.bytes = bytes;
    part.size = (uint16_t)size;
    bool whole = mom_rsp_assembly_push(&assembly, &part);
    free(bytes);
    printf("= %lu ", (unsigned long)assembly.dropped);
    put_hex(assembly.bytes, whole ? assembly.total : 0);
    putchar('\n');
}

/* Ends what an operation prints: its result, and what can be seen of the state. */
static void end_result(void)
{
    uint64_t wake = mom_rsp_wake(&robot), deadline = mom_rsp_deadline(&robot);
    printf(" | %d %llu %llu %u %u ", mom_rsp_is_up(&robot), (unsigned long long)wake, (unsigned long long)deadline,
           mom_rsp_period(&robot), mom_rsp_free_buffers(&robot));
    for (size_t i = 0; i < layout.count; i++)
        putchar(mom_rsp_is_active(&robot, (uint8_t)i) ? '1' : '0');
    putchar('\n');
}

static void operate(const char *verb)
{
    size_t size;
    if (strcmp(verb, "receive") == 0) {
        uint64_t now = (uint64_t)number();
        uint8_t *datagram = unhex(word(), &size);
        printf("= %d", (int)mom_rsp_receive(&robot, now, datagram, size));
        free(datagram);
    } else if (strcmp(verb, "poll") == 0) {
        uint64_t now = (uint64_t)number();
        size_t room = (size_t)number();
        uint8_t *out = allocate(room);
        size = mom_rsp_poll(&robot, now, out, room);
        printf("= ");
        put_hex(out, size);
        free(out);
    } else if (strcmp(verb, "end") == 0) {
        mom_rsp_end(&robot, (uint64_t)number());
        printf("=");
    } else if (strcmp(verb, "counts") == 0) {
        printf("=");
        for (int i = 0; i < MOM_RSP_OUTCOMES; i++)
            printf(" %lu", (unsigned long)mom_rsp_count(&robot, (enum mom_rsp_outcome)i));
    } else {
        uint8_t element = (uint8_t)number();
        uint8_t *bytes = unhex(word(), &size);
        bool sets = strcmp(verb, "set") == 0;
        printf("= %d", (int)(sets ? mom_rsp_set : mom_rsp_raise)(&robot, element, bytes, size));
        free(bytes);
    }
    end_result();
}

int main(void)
{
    static char line[LONGEST];
    while (fgets(line, sizeof line, stdin) != NULL) {
        const char *verb = strtok(line, " \n");
        if (verb == NULL)
            continue;
        if (strcmp(verb, "layout") == 0)
            read_layout();
        else if (strcmp(verb, "element") == 0)
            read_element(&elements[layout.count++]);
        else if (strcmp(verb, "robot") == 0)
            begin();
        else if (strcmp(verb, "random") == 0)
            add_random();
        else if (strcmp(verb, "part") == 0)
            add_part();
        else if (strcmp(verb, "assembly") == 0 || strcmp(verb, "push") == 0 || strcmp(verb, "clear") == 0)
            assemble(verb);
        else
            operate(verb);
    }
    return 0;
}
