/* Blobs put together. */
#include <string.h>

#include "mom_rsp_internal.h"

void mom_rsp_assembly_init(struct mom_rsp_assembly *assembly, uint8_t *bytes, size_t size)
{
    memset(assembly, 0, sizeof *assembly);
    assembly->bytes = bytes;
    assembly->size = size;
}

static void count_dropped(struct mom_rsp_assembly *assembly)
{
    if (assembly->dropped < UINT32_MAX)
        assembly->dropped++;
}

/* A newer blob takes the place of one that is not complete. */
static void begin(struct mom_rsp_assembly *assembly, const struct mom_rsp_fragment *fragment)
{
    uint32_t parts = fragment->total / MOM_RSP_FRAGMENT + (fragment->total % MOM_RSP_FRAGMENT > 0 ? 1 : 0);
    if (assembly->left > 0)
        count_dropped(assembly);
    assembly->begun = true;
    assembly->blob = fragment->blob;
    assembly->total = fragment->total;
    memset(assembly->heard, 0, sizeof assembly->heard);
    if (fragment->total > assembly->size || parts > 256) {
        count_dropped(assembly);
        parts = 0;
    }
    assembly->left = (uint16_t)parts;
}

bool mom_rsp_assembly_push(struct mom_rsp_assembly *assembly, const struct mom_rsp_fragment *fragment)
{
    if (!assembly->begun || assembly->blob != fragment->blob || assembly->total != fragment->total) {
        if (assembly->begun && !mom_rsp_is_newer(fragment->blob, assembly->blob))
            return false;
        begin(assembly, fragment);
    }
    uint32_t place = fragment->offset / MOM_RSP_FRAGMENT;
    if (assembly->left == 0 || place >= 256 || (assembly->heard[place / 64] >> (place % 64) & 1) != 0)
        return false;
    if (fragment->offset > assembly->size || fragment->size > assembly->size - fragment->offset)
        return false;
    memcpy(assembly->bytes + fragment->offset, fragment->bytes, fragment->size);
    assembly->heard[place / 64] |= (uint64_t)1 << (place % 64);
    assembly->left--;
    return assembly->left == 0;
}

void mom_rsp_assembly_clear(struct mom_rsp_assembly *assembly)
{
    if (assembly->left > 0)
        count_dropped(assembly);
    assembly->begun = false;
    assembly->left = 0;
    memset(assembly->heard, 0, sizeof assembly->heard);
}
