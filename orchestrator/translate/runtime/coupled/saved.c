/* Saved states: the numbers of the system, and a state of every inner FMU.
 *
 * Serialised: Header, Scalars, numbers, then of each inner FMU the size of its state (8 bytes) and its bytes.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

typedef struct {
    uint64_t size; /* of all bytes */
    uint64_t format;
    uint64_t system;   /* hash of the token */
    uint64_t checksum; /* of what follows */
} Header;

typedef struct {
    Container *owner;
    Scalars s;
    double *numbers;
    void **inner;
} State;

static const uint64_t FORMAT = 0x31455441545343ull; /* "CSTATE1" in little-endian memory */

/* FNV-1a (Fowler, Noll, Vo), 64 bit. */
static uint64_t hash(const void *data, size_t size)
{
    const unsigned char *bytes = data;
    uint64_t value = 0xcbf29ce484222325ull;
    for (size_t i = 0; i < size; i++) value = (value ^ bytes[i]) * 0x100000001b3ull;
    return value;
}

static State *state_new(Container *c)
{
    State *state = calloc(1, sizeof *state);
    if (!state) return NULL;
    state->owner = c;
    state->numbers = calloc(c->rt.n_saved, sizeof *state->numbers);
    state->inner = calloc((size_t)c->n_inner + 1, sizeof *state->inner);
    if (state->numbers && state->inner) {
        c->kept++;
        return state;
    }
    free(state->numbers);
    free(state->inner);
    free(state);
    return NULL;
}

void rt_state_free(void **at)
{
    State *state = *at;
    Container *c;
    if (!state) return;
    c = state->owner;
    for (int i = 0; i < c->n_inner; i++)
        if (state->inner[i]) inner_state(&c->inner[i], CALL_FORGET, &state->inner[i]);
    free(state->numbers);
    free(state->inner);
    free(state);
    c->kept--;
    *at = NULL;
}

static RtStatus told(Container *c, const char *call, const char *what)
{
    rt_log(&c->rt, RT_ERROR, "%s: %s", call, what);
    return RT_ERROR;
}

static int all_can(const Container *c, int serialise)
{
    for (int i = 0; i < c->n_inner; i++)
        if (!(serialise ? c->inner[i].library->can_serialise : c->inner[i].library->can_save)) return 0;
    return 1;
}

/* *state may hold an earlier state, which is overwritten. */
RtStatus rt_save(Runtime *rt, void **at)
{
    Container *c = (Container *)rt;
    State *state = *at;
    if (!all_can(c, 0)) return told(c, "GetFMUState", "canGetAndSetFMUstate is false");
    if (!state) state = state_new(c);
    if (!state) return told(c, "GetFMUState", "no memory");
    *at = state;
    state->s = rt->s;
    memcpy(state->numbers, rt->saved, rt->n_saved * sizeof *state->numbers);
    for (int i = 0; i < c->n_inner; i++)
        if (inner_state(&c->inner[i], CALL_SAVE, &state->inner[i]) > RT_WARNING) return rt_report(rt, "GetFMUState");
    return RT_OK;
}

RtStatus rt_restore(Runtime *rt, const void *from)
{
    Container *c = (Container *)rt;
    const State *state = from;
    if (state->owner != c) return told(c, "SetFMUState", "the state belongs to another instance");
    for (int i = 0; i < c->n_inner; i++)
        if (inner_state(&c->inner[i], CALL_RESTORE, &state->inner[i]) > RT_WARNING) {
            rt->s.phase = PHASE_ERROR;
            return rt_report(rt, "SetFMUState");
        }
    rt->s = state->s;
    memcpy(rt->saved, state->numbers, rt->n_saved * sizeof *state->numbers);
    return RT_OK;
}

/* 0 if it cannot be told. */
size_t rt_state_size(const void *from)
{
    const State *state = from;
    Container *c = state->owner;
    size_t size = sizeof(Header) + sizeof(Scalars) + c->rt.n_saved * sizeof(double);
    if (!all_can(c, 1)) return 0;
    for (int i = 0; i < c->n_inner; i++) {
        size_t own = 0;
        if (inner_state_size(&c->inner[i], state->inner[i], &own) > RT_WARNING) return 0;
        size += sizeof(uint64_t) + own;
    }
    return size;
}

RtStatus rt_state_write(Runtime *rt, const void *from, unsigned char *bytes, size_t size)
{
    Container *c = (Container *)rt;
    const State *state = from;
    size_t needed = rt_state_size(from);
    unsigned char *at = bytes + sizeof(Header);
    Header header = {needed, FORMAT, hash(c->token, strlen(c->token)), 0};
    if (!needed) return told(c, "SerializeFMUState", "canSerializeFMUstate is false, or an inner FMU failed");
    if (size < needed) return told(c, "SerializeFMUState", "there is not enough room for the state");
    memcpy(at, &state->s, sizeof state->s);
    at += sizeof state->s;
    memcpy(at, state->numbers, rt->n_saved * sizeof(double));
    at += rt->n_saved * sizeof(double);
    for (int i = 0; i < c->n_inner; i++) {
        size_t own = 0;
        uint64_t noted;
        if (inner_state_size(&c->inner[i], state->inner[i], &own) > RT_WARNING) return rt_report(rt, "SerializeFMUState");
        noted = own;
        memcpy(at, &noted, sizeof noted);
        at += sizeof noted;
        if (inner_state_write(&c->inner[i], state->inner[i], at, own) > RT_WARNING)
            return rt_report(rt, "SerializeFMUState");
        at += own;
    }
    header.checksum = hash(bytes + sizeof header, needed - sizeof header);
    memcpy(bytes, &header, sizeof header);
    return RT_OK;
}

static int undamaged(const Container *c, const unsigned char *bytes, size_t size)
{
    Header header;
    if (size < sizeof header + sizeof(Scalars) + c->rt.n_saved * sizeof(double)) return 0;
    memcpy(&header, bytes, sizeof header);
    return header.size == size && header.format == FORMAT && header.system == hash(c->token, strlen(c->token)) &&
           header.checksum == hash(bytes + sizeof header, size - sizeof header);
}

RtStatus rt_state_read(Runtime *rt, const unsigned char *bytes, size_t size, void **to)
{
    Container *c = (Container *)rt;
    const unsigned char *at = bytes + sizeof(Header), *end = bytes + size;
    State *state;
    if (!all_can(c, 1)) return told(c, "DeserializeFMUState", "canSerializeFMUstate is false");
    if (!undamaged(c, bytes, size))
        return told(c, "DeserializeFMUState", "these bytes are no undamaged state of this system");
    rt_state_free(to);
    state = state_new(c);
    if (!state) return told(c, "DeserializeFMUState", "no memory");
    memcpy(&state->s, at, sizeof state->s);
    at += sizeof state->s;
    memcpy(state->numbers, at, rt->n_saved * sizeof(double));
    at += rt->n_saved * sizeof(double);
    for (int i = 0; i < c->n_inner; i++) {
        uint64_t own = 0;
        if ((size_t)(end - at) >= sizeof own) memcpy(&own, at, sizeof own);
        at += sizeof own;
        if (at > end || own > (uint64_t)(end - at) ||
            inner_state_read(&c->inner[i], at, (size_t)own, &state->inner[i]) > RT_WARNING) {
            void *made = state;
            rt_state_free(&made);
            return told(c, "DeserializeFMUState", "the state of an inner FMU cannot be read");
        }
        at += own;
    }
    *to = state;
    return RT_OK;
}
