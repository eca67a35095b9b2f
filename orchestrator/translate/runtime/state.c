/* Saved states: one block of bytes with everything an instance will ever look at again.
 *
 * Block: Header, Scalars, the saved numbers, then per delay operator its Delay and its segments. The same
 * bytes are the serialised state; they fit the same model on machines of the same byte order.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "runtime.h"

typedef struct {
    uint64_t size;      /* of the whole block [byte] */
    uint64_t format;
    uint64_t model;     /* hash of the token */
    uint64_t checksum;  /* of what follows; set when serialised */
} Header;

static const uint64_t FORMAT = 0x31455441545355ull; /* "USTATE1" in little-endian memory */

/* FNV-1a (Fowler, Noll, Vo), 64 bit. */
static uint64_t hash(const void *data, size_t size)
{
    const unsigned char *bytes = data;
    uint64_t value = 0xcbf29ce484222325ull;
    for (size_t i = 0; i < size; i++) value = (value ^ bytes[i]) * 0x100000001b3ull;
    return value;
}

static uint64_t model_hash(void)
{
    return hash(model_info.token, strlen(model_info.token));
}

static size_t fixed_size(const Runtime *rt)
{
    return sizeof(Header) + sizeof(Scalars) + rt->n_saved * sizeof(double) +
           (size_t)model_info.n_d * sizeof(Delay);
}

/* *state may hold an earlier state of this model, which is overwritten. */
RtStatus rt_save(Runtime *rt, void **state)
{
    size_t size = fixed_size(rt);
    unsigned char *block, *at;
    Header header;
    for (int j = 0; j < model_info.n_d; j++)
        size += (size_t)(rt->delays[j].next - rt->delays[j].first) * sizeof(Segment);
    block = *state;
    if (!block || rt_state_size(block) != size) {
        block = realloc(block, size);
        if (!block) {
            rt_log(rt, RT_ERROR, "GetFMUState: no memory for %llu bytes", (unsigned long long)size);
            return RT_ERROR;
        }
        *state = block;
    }
    header.size = size;
    header.format = FORMAT;
    header.model = model_hash();
    header.checksum = 0;
    at = block;
    memcpy(at, &header, sizeof header);
    at += sizeof header;
    memcpy(at, &rt->s, sizeof rt->s);
    at += sizeof rt->s;
    if (rt->n_saved) memcpy(at, rt->saved, rt->n_saved * sizeof(double));
    at += rt->n_saved * sizeof(double);
    for (int j = 0; j < model_info.n_d; j++) {
        const Delay *q = &rt->delays[j];
        memcpy(at, q, sizeof *q);
        at += sizeof *q;
        for (long long n = q->first; n < q->next; n++, at += sizeof(Segment))
            memcpy(at, &rt->rings[j][n & (rt->capacities[j] - 1)], sizeof(Segment));
    }
    return RT_OK;
}

/* Whether the block is a state of this model whose parts add up to its size. */
static int plausible(const Runtime *rt, const unsigned char *block, size_t size)
{
    Header header;
    size_t used = fixed_size(rt), at = used - (size_t)model_info.n_d * sizeof(Delay);
    if (size < used) return 0;
    memcpy(&header, block, sizeof header);
    if (header.size != size || header.format != FORMAT || header.model != model_hash()) return 0;
    for (int j = 0; j < model_info.n_d; j++) {
        Delay q;
        if (size - at < sizeof q) return 0;
        memcpy(&q, block + at, sizeof q);
        if (q.first < 0 || q.next < q.first || (uint64_t)(q.next - q.first) > (size - at) / sizeof(Segment))
            return 0;
        at += sizeof q + (size_t)(q.next - q.first) * sizeof(Segment);
    }
    return at == size;
}

RtStatus rt_restore(Runtime *rt, const void *state)
{
    const unsigned char *at = state;
    if (!plausible(rt, at, rt_state_size(state))) {
        rt_log(rt, RT_ERROR, "SetFMUState: not a state of %s (token %s)", model_info.name, model_info.token);
        return RT_ERROR;
    }
    at += fixed_size(rt) - (size_t)model_info.n_d * sizeof(Delay);
    /* Memory first, so that a failure leaves the instance as it was. */
    for (int j = 0; j < model_info.n_d; j++) {
        Delay q;
        long long capacity = rt->capacities[j] ? rt->capacities[j] : 1;
        memcpy(&q, at, sizeof q);
        at += sizeof q + (size_t)(q.next - q.first) * sizeof(Segment);
        while (capacity < q.next - q.first) capacity *= 2;
        if (capacity > rt->capacities[j]) {
            const Delay *now = &rt->delays[j];
            Segment *ring = malloc((size_t)capacity * sizeof *ring);
            if (!ring) {
                rt_log(rt, RT_ERROR, "SetFMUState: no memory for %lld entries of history", capacity);
                return RT_ERROR;
            }
            for (long long n = now->first; n < now->next; n++)
                ring[n & (capacity - 1)] = rt->rings[j][n & (rt->capacities[j] - 1)];
            free(rt->rings[j]);
            rt->rings[j] = ring;
            rt->capacities[j] = capacity;
        }
    }
    at = (const unsigned char *)state + sizeof(Header);
    memcpy(&rt->s, at, sizeof rt->s);
    at += sizeof rt->s;
    if (rt->n_saved) memcpy(rt->saved, at, rt->n_saved * sizeof(double));
    at += rt->n_saved * sizeof(double);
    for (int j = 0; j < model_info.n_d; j++) {
        Delay *q = &rt->delays[j];
        memcpy(q, at, sizeof *q);
        at += sizeof *q;
        for (long long n = q->first; n < q->next; n++, at += sizeof(Segment))
            memcpy(&rt->rings[j][n & (rt->capacities[j] - 1)], at, sizeof(Segment));
    }
    /* Outputs and derivatives are not saved but computed again. */
    rt->s.outputs_stale = rt->s.derivatives_stale = 1;
    return RT_OK;
}

size_t rt_state_size(const void *state)
{
    Header header;
    memcpy(&header, state, sizeof header);
    return (size_t)header.size;
}

void rt_state_free(void **state)
{
    free(*state);
    *state = NULL;
}

RtStatus rt_state_write(Runtime *rt, const void *state, unsigned char *bytes, size_t size)
{
    Header header;
    size_t needed = rt_state_size(state);
    if (size < needed) {
        rt_log(rt, RT_ERROR, "SerializeFMUState: the state takes %llu bytes, room is for %llu",
               (unsigned long long)needed, (unsigned long long)size);
        return RT_ERROR;
    }
    memcpy(bytes, state, needed);
    memcpy(&header, state, sizeof header);
    header.checksum = hash(bytes + sizeof header, needed - sizeof header);
    memcpy(bytes, &header, sizeof header);
    return RT_OK;
}

RtStatus rt_state_read(Runtime *rt, const unsigned char *bytes, size_t size, void **state)
{
    Header header;
    void *block;
    if (size >= sizeof header) memcpy(&header, bytes, sizeof header);
    if (size < sizeof header || !plausible(rt, bytes, size) ||
        header.checksum != hash(bytes + sizeof header, size - sizeof header)) {
        rt_log(rt, RT_ERROR, "DeserializeFMUState: these %llu bytes are no undamaged state of %s (token %s)",
               (unsigned long long)size, model_info.name, model_info.token);
        return RT_ERROR;
    }
    block = realloc(*state, size);
    if (!block) {
        rt_log(rt, RT_ERROR, "DeserializeFMUState: no memory for %llu bytes", (unsigned long long)size);
        return RT_ERROR;
    }
    memcpy(block, bytes, size);
    *state = block;
    return RT_OK;
}
