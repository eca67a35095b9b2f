/* resources/system.txt: one record a line, fields separated by tabs, everything counted from 0.
 *
 * Numbers are the 16 hexadecimal digits of a double's bits, so that no locale and no rounding can change
 * them; a tab, line end or backslash in a name is written \t, \n or \\. Records, in this order:
 *
 *   orchestrator-system  1  token  name
 *   grid       begin  stride  denominator  step size      times are (begin + n stride)/denominator [s]
 *   master     1 for Gauss-Seidel, 0 for Jacobi
 *   sizes      signals  ports  inputs  externals
 *   library    FMI version  identifier  folder  token  saves states  serialises them
 *   instance   name  library  every  parts  converts  inputs
 *   start      instance  type  reference  values, or a text
 *   order      instance
 *   block      instance  1 to get, 0 to set  type  references  places
 *   feed       source  gain  offset                       for each input in turn
 *   path       place  legs  links
 *   leg        place  gain  offset
 *   link       effect  options  places that it reads  length of its memory
 *   after      instance  path
 *   read       instance  type  reference  element  elements  place  nominal
 *   give       instance  type  reference  element  elements  place  path  gain  offset
 *   loop       reads  gives                               whose records follow
 *   variable   kind  type  place  tunable  instance  type  reference  element  elements  name
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

enum { MOST_FIELDS = 16 };

typedef struct {
    Container *c;
    char *fields[MOST_FIELDS];
    int n, line, memory; /* memory: 1 if there was none */
} Record;

static long long whole(const char *text)
{
    return strtoll(text, NULL, 10);
}

static double number(const char *text)
{
    uint64_t bits = strtoull(text, NULL, 16);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static char *unescaped(char *text)
{
    char *to = text;
    for (char *from = text; *from; from++) {
        if (*from == '\\' && from[1]) {
            from++;
            *to++ = *from == 't' ? '\t' : *from == 'n' ? '\n' : *from;
        } else {
            *to++ = *from;
        }
    }
    *to = 0;
    return text;
}

/* A list of numbers separated by spaces. */
static int count(const char *text)
{
    int n = *text != 0;
    for (; *text; text++) n += *text == ' ';
    return n;
}

static const char *next(const char *text)
{
    while (*text && *text != ' ') text++;
    return *text ? text + 1 : text;
}

static void *room_for(Record *r, int n, size_t size)
{
    void *made = calloc((size_t)(n ? n : 1), size);
    if (!made) r->memory = 1;
    return made;
}

static double *numbers(Record *r, const char *text, int n)
{
    double *made = room_for(r, n, sizeof *made);
    for (int i = 0; made && i < n; i++, text = next(text)) made[i] = number(text);
    return made;
}

static int *wholes(Record *r, const char *text, int n)
{
    int *made = room_for(r, n, sizeof *made);
    for (int i = 0; made && i < n; i++, text = next(text)) made[i] = (int)whole(text);
    return made;
}

/* One more of the list at `list`, zeroed. Lists grow by powers of two. */
static void *grown(Record *r, void *list, int *n, size_t size)
{
    char *items;
    memcpy(&items, list, sizeof items);
    if ((*n & (*n - 1)) == 0) {
        items = realloc(items, (size_t)(*n ? 2 * *n : 1) * size);
        if (!items) {
            r->memory = 1;
            return NULL;
        }
        memcpy(list, &items, sizeof items);
    }
    memset(items + (size_t)*n * size, 0, size);
    return items + (size_t)(*n)++ * size;
}

#define MORE(list) grown(r, &r->c->list, &r->c->n_##list, sizeof *r->c->list)
#define FIELD(i) (r->fields[i])
#define WHOLE(i) ((int)whole(r->fields[i]))

static Place place_of(Record *r, int first)
{
    Place at;
    at.instance = WHOLE(first);
    at.type = (Type)WHOLE(first + 1);
    at.reference = (unsigned)whole(FIELD(first + 2));
    at.element = WHOLE(first + 3);
    at.elements = WHOLE(first + 4);
    return at;
}

static void read_block(Record *r)
{
    Block *block = MORE(blocks);
    Inner *inner = &r->c->inner[WHOLE(1)];
    int place = r->c->n_blocks - 1;
    if (!block) return;
    block->instance = WHOLE(1);
    block->getting = WHOLE(2);
    block->type = (Type)WHOLE(3);
    block->n_references = count(FIELD(4));
    block->references = (unsigned *)wholes(r, FIELD(4), block->n_references);
    block->n_values = count(FIELD(5));
    block->places = wholes(r, FIELD(5), block->n_values);
    block->buffer = buffer_for(block->type, block->n_values);
    if (!block->buffer) r->memory = 1;
    if (block->getting) {
        if (!inner->n_gets++) inner->first_get = place;
    } else if (!inner->n_sets++) {
        inner->first_set = place;
    }
}

static void read_start(Record *r)
{
    Start *start = MORE(starts);
    if (!start) return;
    start->at.instance = WHOLE(1);
    start->at.type = (Type)WHOLE(2);
    start->at.reference = (unsigned)whole(FIELD(3));
    if (start->at.type == V_TEXT) {
        start->text = unescaped(FIELD(4));
    } else {
        start->n = count(FIELD(4));
        start->numbers = numbers(r, FIELD(4), start->n);
    }
}

static void read_instance(Record *r)
{
    Container *c = r->c;
    Inner *inner = MORE(inner);
    if (!inner) return;
    inner->name = unescaped(FIELD(1));
    inner->library = &c->libraries[WHOLE(2)];
    inner->every = WHOLE(3);
    inner->parts = WHOLE(4);
    inner->converts = WHOLE(5);
    inner->n_inputs = WHOLE(6);
    inner->first_input = c->n_inner > 1 ? inner[-1].first_input + inner[-1].n_inputs : 0;
}

static void read_wire(Record *r)
{
    Container *c = r->c;
    if (strcmp(FIELD(0), "path") == 0) {
        Path *path = MORE(paths);
        if (!path) return;
        path->place = WHOLE(1);
        path->n_legs = WHOLE(2);
        path->n_links = WHOLE(3);
        if (c->n_paths > 1) {
            path->first_leg = path[-1].first_leg + path[-1].n_legs;
            path->first_link = path[-1].first_link + path[-1].n_links;
        }
    } else if (strcmp(FIELD(0), "leg") == 0) {
        Feed *leg = MORE(legs);
        if (!leg) return;
        leg->source = WHOLE(1);
        leg->gain = number(FIELD(2));
        leg->offset = number(FIELD(3));
    } else if (strcmp(FIELD(0), "link") == 0) {
        Link *link = MORE(links);
        if (!link) return;
        link->kind = WHOLE(1);
        link->n_options = count(FIELD(2));
        link->options = numbers(r, FIELD(2), link->n_options);
        link->n_reads = count(FIELD(3));
        link->reads = wholes(r, FIELD(3), link->n_reads);
        link->n_memory = WHOLE(4);
        link->first_memory = c->n_memory;
        c->n_memory += link->n_memory;
    } else {
        Inner *inner = &c->inner[WHOLE(1)];
        int *after = MORE(after);
        if (!after) return;
        *after = WHOLE(2);
        if (!inner->n_after++) inner->first_after = c->n_after - 1;
    }
}

static void read_action(Record *r)
{
    Action *action = MORE(actions);
    if (!action) return;
    if (strcmp(FIELD(0), "loop") == 0) {
        action->kind = ACTION_LOOP;
        action->n_reads = WHOLE(1);
        action->n_gives = WHOLE(2);
        return;
    }
    action->at = place_of(r, 1);
    action->place = WHOLE(6);
    action->path = -1;
    if (strcmp(FIELD(0), "read") == 0) {
        action->kind = ACTION_READ;
        action->gain = number(FIELD(7));
        return;
    }
    action->kind = ACTION_GIVE;
    action->path = WHOLE(7);
    action->gain = number(FIELD(8));
    action->offset = number(FIELD(9));
}

static void read_variable(Record *r)
{
    Variable *variable = MORE(variables);
    if (!variable) return;
    variable->kind = (VariableKind)WHOLE(1);
    variable->type = (ModelType)WHOLE(2);
    variable->place = WHOLE(3);
    variable->tunable = WHOLE(4);
    variable->at = place_of(r, 5);
    variable->name = unescaped(FIELD(10));
}

static void read_library(Record *r)
{
    Library *library = MORE(libraries);
    if (!library) return;
    library->version = WHOLE(1);
    library->identifier = unescaped(FIELD(2));
    library->folder = unescaped(FIELD(3));
    library->token = unescaped(FIELD(4));
    library->can_save = WHOLE(5);
    library->can_serialise = WHOLE(6);
}

static void read_feed(Record *r)
{
    Feed *feed = MORE(feeds);
    if (!feed) return;
    feed->source = WHOLE(1);
    feed->gain = number(FIELD(2));
    feed->offset = number(FIELD(3));
}

static void read_grid(Record *r)
{
    r->c->begin = whole(FIELD(1));
    r->c->stride = whole(FIELD(2));
    r->c->denominator = whole(FIELD(3));
    r->c->step_size = number(FIELD(4));
}

static void read_head(Record *r)
{
    r->c->token = unescaped(FIELD(2));
    r->c->name = unescaped(FIELD(3));
}

static void read_master(Record *r)
{
    r->c->late = WHOLE(1);
}

static void read_sizes(Record *r)
{
    r->c->n_signals = WHOLE(1);
    r->c->n_ports = WHOLE(2);
    r->c->n_inputs = WHOLE(3);
    r->c->n_externals = WHOLE(4);
}

static void read_order(Record *r)
{
    int *order = MORE(order);
    if (order) *order = WHOLE(1);
}

static const struct {
    const char *name;
    int fields;
    void (*read)(Record *);
} RECORDS[] = {
    {"orchestrator-system", 4, read_head}, {"grid", 5, read_grid},       {"master", 2, read_master},
    {"sizes", 5, read_sizes},              {"library", 7, read_library}, {"instance", 7, read_instance},
    {"start", 5, read_start},              {"order", 2, read_order},     {"block", 6, read_block},
    {"feed", 4, read_feed},                {"path", 4, read_wire},       {"leg", 4, read_wire},
    {"link", 5, read_wire},                {"after", 3, read_wire},      {"read", 8, read_action},
    {"give", 10, read_action},             {"loop", 3, read_action},     {"variable", 11, read_variable},
};

/* Fill in the container from its text, which is cut up. */
int system_read(Container *c, char *why, size_t room)
{
    Record record = {c, {NULL}, 0, 0, 0}, *r = &record;
    char *line = c->text;
    while (line && *line) {
        char *end = strchr(line, '\n'), *at = line;
        size_t known = 0;
        if (end) *end = 0;
        r->line++;
        for (r->n = 0; at && r->n < MOST_FIELDS; r->n++) {
            char *tab = strchr(at, '\t');
            r->fields[r->n] = at;
            if (tab) *tab = 0;
            at = tab ? tab + 1 : NULL;
        }
        while (known < sizeof RECORDS / sizeof *RECORDS && strcmp(RECORDS[known].name, FIELD(0)) != 0) known++;
        if (known == sizeof RECORDS / sizeof *RECORDS || r->n != RECORDS[known].fields ||
            (r->line == 1 && (known != 0 || strcmp(FIELD(1), "1") != 0))) {
            snprintf(why, room, "resources/system.txt, line %d: cannot read the record %.40s", r->line, FIELD(0));
            return 1;
        }
        RECORDS[known].read(r);
        if (r->memory) {
            snprintf(why, room, "no memory");
            return 1;
        }
        line = end ? end + 1 : NULL;
    }
    if (!c->token || c->stride <= 0 || c->denominator <= 0 || c->n_feeds != c->n_inputs) {
        snprintf(why, room, "resources/system.txt is not complete");
        return 1;
    }
    return 0;
}

void system_forget(Container *c)
{
    for (int i = 0; i < c->n_blocks; i++) {
        free(c->blocks[i].references);
        free(c->blocks[i].places);
        free(c->blocks[i].buffer);
    }
    for (int i = 0; i < c->n_starts; i++) free(c->starts[i].numbers);
    for (int i = 0; i < c->n_links; i++) {
        free(c->links[i].options);
        free(c->links[i].reads);
    }
    free(c->libraries);
    free(c->inner);
    free(c->starts);
    free(c->order);
    free(c->blocks);
    free(c->feeds);
    free(c->paths);
    free(c->legs);
    free(c->links);
    free(c->after);
    free(c->actions);
    free(c->variables);
}
