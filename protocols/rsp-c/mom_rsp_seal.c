/* Headers, the replay window, and what the key is used for: codes on the handshake, and sealed packets. */
#include <string.h>

#include "mom_rsp_internal.h"

/* How many of the newest sequences are known to have been heard or not. */
#define WINDOW 128

void mom_rsp_header_encode(const struct mom_rsp_header *from, uint8_t *to)
{
    to[0] = from->version;
    mom_rsp_put_16(to + 1, from->model);
    to[3] = from->encryption;
    to[4] = from->type;
    mom_rsp_put_16(to + 5, from->sequence);
    mom_rsp_put_32(to + 7, from->stamp);
    memcpy(to + 11, from->session, sizeof from->session);
    mom_rsp_put_16(to + 17, from->last);
    to[19] = from->buffers;
}

enum mom_rsp_outcome mom_rsp_header_decode(struct mom_rsp_header *to, const uint8_t *from, size_t size)
{
    if (size < MOM_RSP_HEADER)
        return MOM_RSP_DROPPED_SHORT;
    to->version = from[0];
    to->model = mom_rsp_get_16(from + 1);
    to->encryption = from[3];
    to->type = from[4];
    to->sequence = mom_rsp_get_16(from + 5);
    to->stamp = mom_rsp_get_32(from + 7);
    memcpy(to->session, from + 11, sizeof to->session);
    to->last = mom_rsp_get_16(from + 17);
    to->buffers = from[19];
    return MOM_RSP_ACCEPTED;
}

/* ---- The handshake ---- */

/* Ends a packet of the handshake of `size` bytes before the code; its bytes, 0 where it does not fit. */
size_t mom_rsp_sign(const struct mom_rsp_robot *robot, uint8_t *packet, size_t room, size_t size)
{
    uint8_t code[32];
    if (!robot->keyed)
        return size;
    if (room < size + MOM_RSP_TAG)
        return 0;
    robot->cipher->code(robot->key, packet, size, code);
    memcpy(packet + size, code, MOM_RSP_TAG);
    return size + MOM_RSP_TAG;
}

/* Whether a packet of the handshake has the right code; `size` becomes that of what stands before it. */
enum mom_rsp_outcome mom_rsp_checked(const struct mom_rsp_robot *robot, const struct mom_rsp_header *header, const uint8_t *packet,
                                     size_t *size)
{
    uint8_t code[32];
    unsigned differs = 0;
    if (header->encryption != (robot->keyed ? 1 : 0))
        return MOM_RSP_DROPPED_ENCRYPTION;
    if (!robot->keyed)
        return MOM_RSP_ACCEPTED;
    *size -= MOM_RSP_TAG; /* a header is longer */
    robot->cipher->code(robot->key, packet, *size, code);
    for (size_t i = 0; i < MOM_RSP_TAG; i++)
        differs |= (unsigned)(code[i] ^ packet[*size + i]);
    mom_rsp_wipe(code, sizeof code);
    if (differs != 0)
        return MOM_RSP_DROPPED_SEALED;
    return *size < MOM_RSP_HEADER ? MOM_RSP_DROPPED_SHORT : MOM_RSP_ACCEPTED;
}

/* One block of HKDF's output: 32 bytes of the text, the session, and the block's number. */
static void expand(const struct mom_rsp_robot *robot, const uint8_t all[32], const char *text, uint8_t key[32])
{
    uint8_t info[32];
    size_t size = strlen(text);
    memcpy(info, text, size);
    memcpy(info + size, robot->pending.session, sizeof robot->pending.session);
    size += sizeof robot->pending.session;
    info[size++] = 1;
    robot->cipher->code(all, info, size, key);
}

/* The session that was given begins, if its first packet is authentic. */
void mom_rsp_begin_traffic(struct mom_rsp_traffic *traffic, const struct mom_rsp_robot *robot)
{
    uint8_t salt[2 * MOM_RSP_NONCE], all[32];
    memset(traffic, 0, sizeof *traffic);
    memcpy(traffic->session, robot->pending.session, sizeof traffic->session);
    traffic->known = true;
    traffic->keyed = robot->keyed;
    if (!robot->keyed)
        return;
    memcpy(salt, robot->pending.hello, MOM_RSP_NONCE);
    memcpy(salt + MOM_RSP_NONCE, robot->pending.welcome, MOM_RSP_NONCE);
    robot->cipher->code(salt, robot->key, sizeof robot->key, all);
    expand(robot, all, "mom rsp down", traffic->down);
    expand(robot, all, "mom rsp up", traffic->up);
    mom_rsp_wipe(all, sizeof all);
}

/* ---- The replay window ---- */

static bool is_heard(const struct mom_rsp_traffic *traffic, uint64_t back)
{
    return (traffic->heard[back / 64] >> (back % 64) & 1) != 0;
}

/* The sequence continued to 64 bits: of those with these low bits the one nearest to the newest that was heard. */
static enum mom_rsp_outcome continued(const struct mom_rsp_traffic *traffic, uint16_t sequence, uint64_t *full)
{
    uint16_t ahead = (uint16_t)(sequence - (uint16_t)traffic->newest);
    if (ahead < 0x8000) {
        if (traffic->newest > UINT64_MAX - ahead)
            return MOM_RSP_DROPPED_OLD;
        *full = traffic->newest + ahead;
        return ahead == 0 && is_heard(traffic, 0) ? MOM_RSP_DROPPED_REPLAYED : MOM_RSP_ACCEPTED;
    }
    uint64_t back = 0x10000u - (uint64_t)ahead;
    if (back >= WINDOW || back > traffic->newest)
        return MOM_RSP_DROPPED_OLD;
    *full = traffic->newest - back;
    return is_heard(traffic, back) ? MOM_RSP_DROPPED_REPLAYED : MOM_RSP_ACCEPTED;
}

static void mark(struct mom_rsp_traffic *traffic, uint64_t full)
{
    if (full > traffic->newest) {
        uint64_t shift = full - traffic->newest;
        uint64_t *heard = traffic->heard;
        if (shift >= 64) {
            heard[1] = shift < WINDOW ? heard[0] << (shift - 64) : 0;
            heard[0] = 0;
        } else {
            heard[1] = heard[1] << shift | heard[0] >> (64 - shift);
            heard[0] <<= shift;
        }
        traffic->newest = full;
    }
    uint64_t back = traffic->newest - full;
    traffic->heard[back / 64] |= (uint64_t)1 << (back % 64);
}

/* ---- Packets of a session ---- */

static void nonce_of(uint64_t counter, uint8_t nonce[12])
{
    memset(nonce, 0, 4);
    mom_rsp_put_32(nonce + 4, (uint32_t)(counter >> 32));
    mom_rsp_put_32(nonce + 8, (uint32_t)counter);
}

/* Opens a packet that was not heard before: `full` is its sequence; `size` becomes that of header and body. */
enum mom_rsp_outcome mom_rsp_open(struct mom_rsp_traffic *traffic, const struct mom_rsp_cipher *cipher, const struct mom_rsp_header *header,
                                  uint8_t *packet, size_t *size, uint64_t *full)
{
    uint8_t nonce[12];
    if (header->encryption != (traffic->keyed ? 1 : 0))
        return MOM_RSP_DROPPED_ENCRYPTION;
    enum mom_rsp_outcome outcome = continued(traffic, header->sequence, full);
    if (outcome != MOM_RSP_ACCEPTED)
        return outcome;
    if (traffic->keyed) {
        if (*size < MOM_RSP_HEADER + MOM_RSP_TAG)
            return MOM_RSP_DROPPED_SHORT;
        *size -= MOM_RSP_TAG;
        nonce_of(*full, nonce);
        if (!cipher->open(traffic->down, nonce, packet, packet + MOM_RSP_HEADER, *size - MOM_RSP_HEADER, packet + *size))
            return MOM_RSP_DROPPED_SEALED;
    }
    mark(traffic, *full);
    return MOM_RSP_ACCEPTED;
}

/* Makes a packet of the body of `size` bytes that stands behind the header's place; its bytes, 0 where it does not fit. */
size_t mom_rsp_close(struct mom_rsp_robot *robot, uint8_t type, uint64_t now, uint8_t *packet, size_t room, size_t size)
{
    struct mom_rsp_traffic *traffic = &robot->traffic;
    size_t end = MOM_RSP_HEADER + size;
    if (!traffic->known || room < end + (traffic->keyed ? MOM_RSP_TAG : 0))
        return 0;
    struct mom_rsp_header header = {
        .version = 1,
        .model = robot->layout->id,
        .encryption = traffic->keyed ? 1 : 0,
        .type = type,
        .sequence = (uint16_t)traffic->next,
        .stamp = (uint32_t)(now / 1000),
        .last = traffic->has_data ? (uint16_t)traffic->data : 0xFFFF,
        .buffers = mom_rsp_free_buffers(robot)
    };
    memcpy(header.session, traffic->session, sizeof header.session);
    mom_rsp_header_encode(&header, packet);
    if (traffic->keyed) {
        uint8_t nonce[12];
        nonce_of(traffic->next, nonce);
        robot->cipher->seal(traffic->up, nonce, packet, packet + MOM_RSP_HEADER, size, packet + end);
        end += MOM_RSP_TAG;
    }
    traffic->next++;
    return end;
}
