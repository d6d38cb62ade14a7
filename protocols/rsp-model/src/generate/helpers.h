/* Bytes that are somewhere else. */
struct NAME_bytes {
    uint16_t size;
    const uint8_t *bytes;
};

/* The bit of an element; that of the first is the highest of the first byte. */
static inline int NAME_bit(const uint8_t *map, enum NAME_element element)
{
    return map[(size_t)element / 8] >> (7 - (size_t)element % 8) & 1;
}

/* Makes the bit of an element 1. */
static inline void NAME_set_bit(uint8_t *map, enum NAME_element element)
{
    map[(size_t)element / 8] |= (uint8_t)(0x80 >> (size_t)element % 8);
}

/* Whether the bits behind the last element are 0. */
static inline int NAME_is_padded(const uint8_t *map)
{
    return PREFIX_ELEMENTS % 8 == 0 || (uint8_t)(map[PREFIX_MAP_SIZE - 1] << PREFIX_ELEMENTS % 8) == 0;
}

static inline size_t NAME_put_8(uint8_t *to, uint8_t value)
{
    to[0] = value;
    return 1;
}

static inline size_t NAME_put_16(uint8_t *to, uint16_t value)
{
    to[0] = (uint8_t)(value >> 8);
    to[1] = (uint8_t)value;
    return 2;
}

static inline size_t NAME_put_32(uint8_t *to, uint32_t value)
{
    NAME_put_16(to, (uint16_t)(value >> 16));
    NAME_put_16(to + 2, (uint16_t)value);
    return 4;
}

static inline uint8_t NAME_get_8(const uint8_t *from)
{
    return from[0];
}

static inline uint16_t NAME_get_16(const uint8_t *from)
{
    return (uint16_t)((unsigned)from[0] << 8 | from[1]);
}

static inline uint32_t NAME_get_32(const uint8_t *from)
{
    return (uint32_t)NAME_get_16(from) << 16 | NAME_get_16(from + 2);
}

static inline uint32_t NAME_of_float(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* Whether the bits of a float are neither infinite nor no number. */
static inline int NAME_is_finite(uint32_t bits)
{
    return (bits & 0x7f800000u) != 0x7f800000u;
}

static inline float NAME_to_float(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}
