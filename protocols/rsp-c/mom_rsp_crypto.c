/*
 * The portable cipher: SHA-256 (FIPS 180-4), HMAC (RFC 2104), ChaCha20, Poly1305 and their AEAD (RFC 8439). No step depends on a secret:
 * neither a branch nor an address. It is small and not fast: hardware that has one of these may take its place.
 */
#include <string.h>

#include "mom_rsp_internal.h"

void mom_rsp_wipe(void *bytes, size_t size)
{
    /* Writes to what is volatile are not left out, though nothing reads them. */
    volatile uint8_t *at = bytes;
    while (size-- > 0)
        *at++ = 0;
}

/* ---- SHA-256 ---- */

struct sha256 {
    uint32_t state[8];
    uint8_t block[64];
    uint64_t size;
};

static const uint32_t ROUNDS[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98, 0x12835b01, 0x243185be,
    0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa,
    0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85,
    0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3,
    0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f,
    0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2
};

static uint32_t right(uint32_t word, unsigned bits)
{
    return word >> bits | word << (32 - bits);
}

static void sha256_begin(struct sha256 *hash)
{
    static const uint32_t first[8] = { 0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19 };
    memcpy(hash->state, first, sizeof first);
    hash->size = 0;
}

static void sha256_block(struct sha256 *hash)
{
    uint32_t words[64], v[8];
    for (size_t i = 0; i < 16; i++)
        words[i] = mom_rsp_get_32(hash->block + 4 * i);
    for (size_t i = 16; i < 64; i++) {
        uint32_t a = words[i - 15], b = words[i - 2];
        words[i] = words[i - 16] + words[i - 7] + (right(a, 7) ^ right(a, 18) ^ a >> 3) + (right(b, 17) ^ right(b, 19) ^ b >> 10);
    }
    memcpy(v, hash->state, sizeof v);
    for (size_t i = 0; i < 64; i++) {
        uint32_t choice = (v[4] & v[5]) ^ (~v[4] & v[6]);
        uint32_t majority = (v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]);
        uint32_t one = v[7] + (right(v[4], 6) ^ right(v[4], 11) ^ right(v[4], 25)) + choice + ROUNDS[i] + words[i];
        uint32_t two = (right(v[0], 2) ^ right(v[0], 13) ^ right(v[0], 22)) + majority;
        memmove(v + 1, v, 7 * sizeof v[0]);
        v[4] += one;
        v[0] = one + two;
    }
    for (size_t i = 0; i < 8; i++)
        hash->state[i] += v[i];
    mom_rsp_wipe(words, sizeof words);
    mom_rsp_wipe(v, sizeof v);
}

static void sha256_add(struct sha256 *hash, const uint8_t *bytes, size_t size)
{
    while (size > 0) {
        size_t at = (size_t)(hash->size % 64);
        size_t part = size < 64 - at ? size : 64 - at;
        memcpy(hash->block + at, bytes, part);
        hash->size += part;
        bytes += part;
        size -= part;
        if (at + part == 64)
            sha256_block(hash);
    }
}

static void sha256_end(struct sha256 *hash, uint8_t digest[32])
{
    static const uint8_t padding[64] = { 0x80 };
    uint64_t bits = hash->size * 8;
    uint8_t size[8];
    mom_rsp_put_32(size, (uint32_t)(bits >> 32));
    mom_rsp_put_32(size + 4, (uint32_t)bits);
    sha256_add(hash, padding, 1 + (size_t)((119 - hash->size % 64) % 64));
    sha256_add(hash, size, sizeof size);
    for (size_t i = 0; i < 8; i++)
        mom_rsp_put_32(digest + 4 * i, hash->state[i]);
    mom_rsp_wipe(hash, sizeof *hash);
}

/* ---- HMAC ---- */

static void hmac_begin(struct sha256 *hash, const uint8_t key[32], uint8_t pad)
{
    uint8_t block[64];
    memset(block, pad, sizeof block);
    for (size_t i = 0; i < 32; i++)
        block[i] ^= key[i];
    sha256_begin(hash);
    sha256_add(hash, block, sizeof block);
    mom_rsp_wipe(block, sizeof block);
}

static void hmac(const uint8_t key[32], const uint8_t *bytes, size_t size, uint8_t code[32])
{
    struct sha256 hash;
    hmac_begin(&hash, key, 0x36);
    sha256_add(&hash, bytes, size);
    sha256_end(&hash, code);
    hmac_begin(&hash, key, 0x5c);
    sha256_add(&hash, code, 32);
    sha256_end(&hash, code);
}

/* ---- ChaCha20; its numbers are little-endian ---- */

static uint32_t get_little(const uint8_t *from)
{
    return (uint32_t)from[3] << 24 | (uint32_t)from[2] << 16 | (uint32_t)from[1] << 8 | from[0];
}

static void put_little(uint8_t *to, uint32_t value)
{
    for (unsigned i = 0; i < 4; i++)
        to[i] = (uint8_t)(value >> (8 * i));
}

static void mix(uint32_t *words, size_t a, size_t b, unsigned left)
{
    uint32_t mixed = words[a] ^ words[b];
    words[a] = mixed << left | mixed >> (32 - left);
}

static void quarter(uint32_t *words, size_t a, size_t b, size_t c, size_t d)
{
    words[a] += words[b];
    mix(words, d, a, 16);
    words[c] += words[d];
    mix(words, b, c, 12);
    words[a] += words[b];
    mix(words, d, a, 8);
    words[c] += words[d];
    mix(words, b, c, 7);
}

/* The block of the key stream with this number. */
static void chacha_block(const uint8_t key[32], const uint8_t nonce[12], uint32_t number, uint8_t block[64])
{
    uint32_t first[16] = { 0x61707865, 0x3320646e, 0x79622d32, 0x6b206574 }, words[16];
    for (size_t i = 0; i < 8; i++)
        first[4 + i] = get_little(key + 4 * i);
    first[12] = number;
    for (size_t i = 0; i < 3; i++)
        first[13 + i] = get_little(nonce + 4 * i);
    memcpy(words, first, sizeof words);
    for (int round = 0; round < 10; round++) {
        for (size_t i = 0; i < 4; i++)
            quarter(words, i, 4 + i, 8 + i, 12 + i);
        for (size_t i = 0; i < 4; i++)
            quarter(words, i, 4 + (i + 1) % 4, 8 + (i + 2) % 4, 12 + (i + 3) % 4);
    }
    for (size_t i = 0; i < 16; i++)
        put_little(block + 4 * i, words[i] + first[i]);
    mom_rsp_wipe(words, sizeof words);
    mom_rsp_wipe(first, sizeof first);
}

static void chacha(const uint8_t key[32], const uint8_t nonce[12], uint8_t *bytes, size_t size)
{
    uint8_t block[64];
    for (size_t at = 0; at < size; at++) {
        if (at % 64 == 0)
            chacha_block(key, nonce, (uint32_t)(1 + at / 64), block);
        bytes[at] ^= block[at % 64];
    }
    mom_rsp_wipe(block, sizeof block);
}

/* ---- Poly1305: numbers modulo 2^130 - 5, as five limbs of 26 bits ---- */

#define LIMB 0x3ffffffu

struct poly1305 {
    uint32_t r[5], h[5];
    uint8_t block[17];
    size_t used;
};

/* The limbs of a block of 17 bytes. */
static void limbs(const uint8_t block[17], uint32_t to[5])
{
    to[0] = get_little(block) & LIMB;
    to[1] = get_little(block + 3) >> 2 & LIMB;
    to[2] = get_little(block + 6) >> 4 & LIMB;
    to[3] = get_little(block + 9) >> 6 & LIMB;
    to[4] = (get_little(block + 12) >> 8 | (uint32_t)block[16] << 24) & LIMB;
}

/* h = (h + block) * r */
static void poly_block(struct poly1305 *poly)
{
    uint32_t added[5];
    uint64_t product[5] = { 0 }, carry = 0;
    limbs(poly->block, added);
    for (size_t i = 0; i < 5; i++)
        added[i] += poly->h[i];
    /* What is above 2^130 comes back five times. */
    for (size_t i = 0; i < 5; i++)
        for (size_t j = 0; j < 5; j++)
            product[(i + j) % 5] += (uint64_t)added[i] * (i + j < 5 ? poly->r[j] : 5 * poly->r[j]);
    for (size_t i = 0; i < 5; i++) {
        product[i] += carry;
        poly->h[i] = (uint32_t)product[i] & LIMB;
        carry = product[i] >> 26;
    }
    carry = poly->h[0] + 5 * carry;
    poly->h[0] = (uint32_t)carry & LIMB;
    poly->h[1] += (uint32_t)(carry >> 26);
    poly->used = 0;
}

static void poly_begin(struct poly1305 *poly, const uint8_t key[32])
{
    memset(poly, 0, sizeof *poly);
    memcpy(poly->block, key, 16);
    for (size_t i = 3; i < 16; i += 4)
        poly->block[i] &= 15;
    for (size_t i = 4; i < 16; i += 4)
        poly->block[i] &= 252;
    limbs(poly->block, poly->r);
    poly->block[16] = 1;
}

/* Adds bytes, and zeros until a block of 16 is full. */
static void poly_add(struct poly1305 *poly, const uint8_t *bytes, size_t size)
{
    for (size_t at = 0; at < size; at++) {
        poly->block[poly->used++] = bytes[at];
        if (poly->used == 16)
            poly_block(poly);
    }
    if (poly->used > 0) {
        memset(poly->block + poly->used, 0, 16 - poly->used);
        poly_block(poly);
    }
}

static void poly_end(struct poly1305 *poly, const uint8_t key[32], uint8_t tag[16])
{
    uint32_t *h = poly->h, less[5], carry = 0;
    for (int round = 0; round < 2; round++) {
        for (size_t i = 0; i < 5; i++) {
            h[i] += carry;
            carry = h[i] >> 26;
            h[i] &= LIMB;
        }
        carry *= 5;
    }
    h[0] += carry;
    /* h + 5 - 2^130 is the number that is meant, if it is not below 0. */
    carry = 5;
    for (size_t i = 0; i < 5; i++) {
        less[i] = h[i] + carry;
        carry = less[i] >> 26;
        less[i] &= LIMB;
    }
    uint32_t mask = 0u - carry;
    for (size_t i = 0; i < 5; i++)
        h[i] = (h[i] & ~mask) | (less[i] & mask);
    uint32_t words[4] = { h[0] | h[1] << 26, h[1] >> 6 | h[2] << 20, h[2] >> 12 | h[3] << 14, h[3] >> 18 | h[4] << 8 };
    uint64_t sum = 0;
    for (size_t i = 0; i < 4; i++) {
        sum = (sum >> 32) + words[i] + get_little(key + 16 + 4 * i);
        put_little(tag + 4 * i, (uint32_t)sum);
    }
    mom_rsp_wipe(poly, sizeof *poly);
    mom_rsp_wipe(less, sizeof less);
    mom_rsp_wipe(words, sizeof words);
}

/* ---- The AEAD ---- */

/* The tag of what is encrypted and of the `more` bytes before it that are not. */
static void authenticate(const uint8_t key[32], const uint8_t nonce[12], const uint8_t *header, size_t more, const uint8_t *bytes,
                         size_t size, uint8_t tag[16])
{
    struct poly1305 poly;
    uint8_t block[64], sizes[16] = { 0 };
    chacha_block(key, nonce, 0, block);
    poly_begin(&poly, block);
    poly_add(&poly, header, more);
    poly_add(&poly, bytes, size);
    put_little(sizes, (uint32_t)more);
    put_little(sizes + 8, (uint32_t)size);
    poly_add(&poly, sizes, sizeof sizes);
    poly_end(&poly, block, tag);
    mom_rsp_wipe(block, sizeof block);
}

static void seal(const uint8_t key[32], const uint8_t nonce[12], const uint8_t header[20], uint8_t *bytes, size_t size, uint8_t tag[16])
{
    chacha(key, nonce, bytes, size);
    authenticate(key, nonce, header, MOM_RSP_HEADER, bytes, size, tag);
}

static bool open(const uint8_t key[32], const uint8_t nonce[12], const uint8_t header[20], uint8_t *bytes, size_t size,
                 const uint8_t tag[16])
{
    uint8_t right_one[16];
    unsigned differs = 0;
    authenticate(key, nonce, header, MOM_RSP_HEADER, bytes, size, right_one);
    for (size_t i = 0; i < sizeof right_one; i++)
        differs |= (unsigned)(right_one[i] ^ tag[i]);
    mom_rsp_wipe(right_one, sizeof right_one);
    if (differs != 0)
        return false;
    chacha(key, nonce, bytes, size);
    return true;
}

const struct mom_rsp_cipher mom_rsp_portable_cipher = { hmac, seal, open };
