/* The vectors of the standards, for the portable cipher; it prints how many it has checked, and stops at one that is wrong. */
#include <stdio.h>
#include <stdlib.h>

#include "../mom_rsp_crypto.c"

static int checked;

static size_t unhex(const char *digits, uint8_t *bytes)
{
    size_t size = strlen(digits) / 2;
    for (size_t i = 0; i < size; i++) {
        char pair[3] = { digits[2 * i], digits[2 * i + 1], 0 };
        bytes[i] = (uint8_t)strtoul(pair, NULL, 16);
    }
    return size;
}

static void check(const char *what, const uint8_t *bytes, const char *digits)
{
    uint8_t expected[256];
    size_t size = unhex(digits, expected);
    if (memcmp(bytes, expected, size) != 0) {
        fprintf(stderr, "%s is wrong\n", what);
        exit(1);
    }
    checked++;
}

/* FIPS 180-4, the examples of NIST. */
static void hashes(void)
{
    static const char *const vectors[][2] = {
        { "", "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855" },
        { "abc", "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad" },
        { "abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq",
          "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1" }
    };
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++) {
        struct sha256 hash;
        uint8_t digest[32];
        sha256_begin(&hash);
        sha256_add(&hash, (const uint8_t *)vectors[i][0], strlen(vectors[i][0]));
        sha256_end(&hash, digest);
        check("SHA-256", digest, vectors[i][1]);
    }
}

/* RFC 4231, cases 1 to 4; a key is the same with zeros behind it. */
static void codes(void)
{
    uint8_t key[32] = { 0 }, bytes[64], code[32];
    memset(key, 0x0b, 20);
    hmac(key, (const uint8_t *)"Hi There", 8, code);
    check("HMAC, case 1", code, "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7");
    memset(key, 0, sizeof key);
    memcpy(key, "Jefe", 4);
    hmac(key, (const uint8_t *)"what do ya want for nothing?", 28, code);
    check("HMAC, case 2", code, "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843");
    memset(key, 0xaa, 20);
    memset(bytes, 0xdd, 50);
    hmac(key, bytes, 50, code);
    check("HMAC, case 3", code, "773ea91e36800e46854db8ebd09181a72959098b3ef8c122d9635514ced565fe");
    unhex("0102030405060708090a0b0c0d0e0f10111213141516171819", key);
    memset(bytes, 0xcd, 50);
    hmac(key, bytes, 50, code);
    check("HMAC, case 4", code, "82558a389a443c0ea4cc819899f2083a85f0faa3e578f8077a2e3ff46729665b");
}

/* RFC 5869, case 1: the first block of its output. */
static void derivation(void)
{
    uint8_t salt[32] = { 0 }, key[22], all[32], info[11], out[32];
    unhex("000102030405060708090a0b0c", salt);
    memset(key, 0x0b, sizeof key);
    hmac(salt, key, sizeof key, all);
    check("HKDF, extract", all, "077709362c2e32df0ddc3f0dc47bba6390b6c73bb50f9c3122ec844ad7c2b3e5");
    unhex("f0f1f2f3f4f5f6f7f8f901", info);
    hmac(all, info, sizeof info, out);
    check("HKDF, expand", out, "3cb25f25faacd57a90434f64d0362f2a2d2d0a90cf1a5a4c5db02d56ecc4c5bf");
}

/* RFC 8439, 2.3.2. */
static void stream(void)
{
    uint8_t key[32], nonce[12], block[64];
    for (size_t i = 0; i < 32; i++)
        key[i] = (uint8_t)i;
    unhex("000000090000004a00000000", nonce);
    chacha_block(key, nonce, 1, block);
    check("ChaCha20", block,
          "10f1e7e4d13b5915500fdd1fa32071c4c7d1f4c733c068030422aa9ac3d46c4e"
          "d2826446079faa0914c2d705d98b02a2b5129cd1de164eb9cbd083e8a2503c4e");
}

/* RFC 8439, A.3, cases 1 and 7 to 11: messages of whole blocks, whose sums come to the end of the numbers. */
static void tags(void)
{
#define F15 "ffffffffffffffffffffffffffffff"
#define N15 "000000000000000000000000000000"
    static const char *const vectors[][3] = {
        { "00" N15 "00" N15, "00" N15 "00" N15 "00" N15 "00" N15, "00" N15 },
        { "02" N15 "00" N15, "ff" F15, "03" N15 },
        { "02" N15 "ff" F15, "02" N15, "03" N15 },
        { "01" N15 "00" N15, "ff" F15 "f0" F15 "11" N15, "05" N15 },
        { "01" N15 "00" N15, "ff" F15 "fbfefefefefefefefefefefefefefefe01010101010101010101010101010101", "00" N15 },
        { "02" N15 "00" N15, "fd" F15, "fa" F15 }
    };
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++) {
        uint8_t key[32], bytes[64], tag[16];
        struct poly1305 poly;
        unhex(vectors[i][0], key);
        poly_begin(&poly, key);
        poly_add(&poly, bytes, unhex(vectors[i][1], bytes));
        poly_end(&poly, key, tag);
        check("Poly1305", tag, vectors[i][2]);
    }
}

/* RFC 8439, 2.8.2. */
static void sealed(void)
{
    static const char text[] = "Ladies and Gentlemen of the class of '99: If I could offer you only one tip for the future, "
                               "sunscreen would be it.";
    uint8_t key[32], nonce[12], more[12], bytes[114], tag[16];
    for (size_t i = 0; i < 32; i++)
        key[i] = (uint8_t)(0x80 + i);
    unhex("070000004041424344454647", nonce);
    unhex("50515253c0c1c2c3c4c5c6c7", more);
    memcpy(bytes, text, sizeof bytes);
    chacha(key, nonce, bytes, sizeof bytes);
    check("the AEAD's text", bytes,
          "d31a8d34648e60db7b86afbc53ef7ec2a4aded51296e08fea9e2b5a736ee62d63dbea45e8ca9671282fafb69da92728b"
          "1a71de0a9e060b2905d6a5b67ecd3b3692ddbd7f2d778b8c9803aee328091b58fab324e4fad675945585808b4831d7bc"
          "3ff4def08e4b7a9de576d26586cec64b6116");
    authenticate(key, nonce, more, sizeof more, bytes, sizeof bytes, tag);
    check("the AEAD's tag", tag, "1ae10b594f09e26a7e902ecbd0600691");
}

/* What is changed anywhere is not opened, and stays as it is. */
static void forged(void)
{
    uint8_t key[32] = { 7 }, nonce[12] = { 1 }, header[20] = { 2 }, bytes[70] = { 3 }, tag[16];
    seal(key, nonce, header, bytes, sizeof bytes, tag);
    for (size_t bit = 0; bit < 8 * (sizeof header + sizeof bytes + sizeof tag); bit++) {
        uint8_t all[sizeof header + sizeof bytes + sizeof tag], before[sizeof all];
        memcpy(all, header, sizeof header);
        memcpy(all + sizeof header, bytes, sizeof bytes);
        memcpy(all + sizeof header + sizeof bytes, tag, sizeof tag);
        all[bit / 8] ^= (uint8_t)(1 << bit % 8);
        memcpy(before, all, sizeof all);
        if (open(key, nonce, all, all + sizeof header, sizeof bytes, all + sizeof header + sizeof bytes)
            || memcmp(all, before, sizeof all) != 0) {
            fprintf(stderr, "bit %zu may be changed\n", bit);
            exit(1);
        }
        checked++;
    }
    static const uint8_t plain[70] = { 3 };
    if (!open(key, nonce, header, bytes, sizeof bytes, tag) || memcmp(bytes, plain, sizeof plain) != 0) {
        fprintf(stderr, "what is right is not opened\n");
        exit(1);
    }
    checked++;
}

int main(void)
{
    hashes();
    codes();
    derivation();
    stream();
    tags();
    sealed();
    forged();
    printf("%d checked\n", checked);
    return 0;
}
