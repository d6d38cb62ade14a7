/* The types of packets. */
enum NAME_type {
    PREFIX_TYPE_HELLO = 0x00,
    PREFIX_TYPE_DATA = 0x01,
    PREFIX_TYPE_CONTROL = 0x02,
    PREFIX_TYPE_FRAGMENT = 0x03,
    PREFIX_TYPE_END = 0x04,
    PREFIX_TYPE_WELCOME = 0x80,
    PREFIX_TYPE_UP_DATA = 0x81,
    PREFIX_TYPE_UP_CONTROL = 0x82,
    PREFIX_TYPE_UP_FRAGMENT = 0x83,
    PREFIX_TYPE_UP_END = 0x84,
    PREFIX_TYPE_REFUSAL = 0x85
};

/* The header of a packet. */
struct NAME_header {
    uint8_t version;     /* 1 */
    uint16_t model;      /* PREFIX_MODEL_ID */
    uint8_t encryption;  /* 0 none, 1 ChaCha20-Poly1305 */
    uint8_t type;        /* enum NAME_type */
    uint16_t sequence;   /* counts packets of this direction, from 0 */
    uint32_t stamp;      /* ms of the sender's clock */
    uint8_t session[6];
    uint16_t last;       /* the newest data packet heard from the other end, 0xffff before the first */
    uint8_t buffers;     /* down: +1 for "clear your buffers"; up: how many are free */
};

static inline void NAME_header_encode(const struct NAME_header *from, uint8_t to[PREFIX_HEADER_SIZE])
{
    to[0] = from->version;
    NAME_put_16(to + 1, from->model);
    to[3] = from->encryption;
    to[4] = from->type;
    NAME_put_16(to + 5, from->sequence);
    NAME_put_32(to + 7, from->stamp);
    memcpy(to + 11, from->session, sizeof from->session);
    NAME_put_16(to + 17, from->last);
    to[19] = from->buffers;
}

/* Reads a header: 1, or 0 if the packet is too short, or of another version or model. */
static inline int NAME_header_decode(struct NAME_header *to, const uint8_t *from, size_t size)
{
    if (size < PREFIX_HEADER_SIZE)
        return 0;
    to->version = from[0];
    to->model = NAME_get_16(from + 1);
    to->encryption = from[3];
    to->type = from[4];
    to->sequence = NAME_get_16(from + 5);
    to->stamp = NAME_get_32(from + 7);
    memcpy(to->session, from + 11, sizeof to->session);
    to->last = NAME_get_16(from + 17);
    to->buffers = from[19];
    return to->version == 1 && to->model == PREFIX_MODEL_ID;
}
