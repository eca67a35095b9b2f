/* Life cycle of a system, access to its variables, and steps of an importer. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

static Container *container(Runtime *rt)
{
    return (Container *)rt;
}

/* One block for everything that a saved state copies. */
static int lay_out(Container *c)
{
    size_t n = 2 + (size_t)c->n_signals + (size_t)c->n_inputs + (size_t)c->n_externals + (size_t)c->n_inner +
               (size_t)c->n_memory;
    double *at = c->rt.saved = calloc(n, sizeof *at);
    if (!at) return 1;
    c->rt.n_saved = n;
    c->index = at++;
    c->stale = at++;
    c->signals = at, at += c->n_signals;
    c->inputs = at, at += c->n_inputs;
    c->externals = at, at += c->n_externals;
    c->begun = at, at += c->n_inner;
    c->memory = at;
    return 0;
}

static RtStatus fresh(Container *c)
{
    RtStatus status = RT_OK;
    memset(&c->rt.s, 0, sizeof c->rt.s);
    memset(c->rt.saved, 0, c->rt.n_saved * sizeof(double));
    c->rt.s.phase = PHASE_INSTANTIATED;
    *c->stale = 1;
    for (int i = 0; i < c->n_starts && status <= RT_WARNING; i++) status = inner_start(c, &c->starts[i]);
    /* What an unconnected input starts with is among the start values. */
    for (int v = 0; v < c->n_variables; v++)
        for (int i = 0; c->variables[v].kind == VARIABLE_INPUT && i < c->n_starts; i++) {
            const Place *at = &c->variables[v].at, *start = &c->starts[i].at;
            if (start->instance == at->instance && start->type == at->type &&
                start->reference == at->reference && at->element < c->starts[i].n)
                c->externals[c->variables[v].place] = c->starts[i].numbers[at->element];
        }
    return status;
}

static int begin(Container *c, const char *token, const char *resources, char *why, size_t room)
{
    size_t size;
    char *path;
    c->resources = file_path(resources ? resources : "");
    size = c->resources ? strlen(c->resources) + 16 : 0;
    path = c->resources ? malloc(size) : NULL;
    if (!path) {
        snprintf(why, room, "no memory");
        return 1;
    }
    snprintf(path, size, "%s/system.txt", c->resources);
    c->text = file_content(path);
    if (!c->text) snprintf(why, room, "cannot read %s: the FMU has to be unpacked, and its place told", path);
    free(path);
    if (!c->text || system_read(c, why, room)) return 1;
    if (!token || strcmp(token, c->token) != 0) {
        snprintf(why, room, "the GUID or token is not that of resources/system.txt: modelDescription.xml "
                            "belongs to another build");
        return 1;
    }
    if (lay_out(c)) {
        snprintf(why, room, "no memory");
        return 1;
    }
    for (int i = 0; i < c->n_libraries; i++)
        if (library_load(&c->libraries[i], c->resources, why, room)) return 1;
    for (int i = 0; i < c->n_inner; i++)
        if (inner_make(c, &c->inner[i], why, room)) return 1;
    if (fresh(c) > RT_WARNING) {
        snprintf(why, room, "start values: %s%s", c->rt.trouble_text, c->early);
        return 1;
    }
    return 0;
}

Runtime *rt_new(const char *instance_name, const char *token, const char *resources, char *why, size_t room)
{
    Container *c = calloc(1, sizeof *c);
    snprintf(why, room, "no memory");
    if (!c) return NULL;
    c->rt.instance_name = malloc(strlen(instance_name) + 1);
    if (c->rt.instance_name) {
        strcpy(c->rt.instance_name, instance_name);
        if (!begin(c, token, resources, why, room)) return &c->rt;
    }
    rt_free(&c->rt);
    return NULL;
}

void rt_free(Runtime *rt)
{
    Container *c = container(rt);
    if (!c) return;
    for (int i = c->n_inner - 1; i >= 0; i--) inner_free(&c->inner[i]);
    for (int i = 0; i < c->n_libraries; i++) library_unload(&c->libraries[i]);
    system_forget(c);
    free(c->text);
    free(c->resources);
    free(c->rt.saved);
    free(c->rt.instance_name);
    free(c->rt.functions);
    free(c);
}

/* Tell the trouble; what cannot be repeated leaves nothing but to free or reset. */
static RtStatus broken(Container *c, const char *call)
{
    c->rt.s.phase = PHASE_ERROR;
    return rt_report(&c->rt, call);
}

RtStatus rt_reset(Runtime *rt)
{
    Container *c = container(rt);
    for (int i = 0; i < c->n_inner; i++)
        if (inner_call(&c->inner[i], CALL_RESET) > RT_WARNING) return broken(c, "Reset");
    return fresh(c) > RT_WARNING ? broken(c, "Reset") : RT_OK;
}

RtStatus rt_terminate(Runtime *rt)
{
    Container *c = container(rt);
    RtStatus worst = RT_OK;
    for (int i = 0; i < c->n_inner; i++) {
        RtStatus status = inner_call(&c->inner[i], CALL_TERMINATE);
        if (status > worst) worst = status;
    }
    rt->s.phase = PHASE_TERMINATED;
    return worst > RT_WARNING ? rt_report(rt, "Terminate") : worst;
}

/* The system runs with its own accuracy, as it was configured: an importer's tolerance is not passed on. */
RtStatus rt_set_up(Runtime *rt, int tolerance_defined, double tolerance, double start_time, int stop_defined,
                   double stop_time)
{
    (void)tolerance_defined, (void)tolerance;
    if (!isfinite(start_time) || (stop_defined && !(stop_time >= start_time))) {
        rt_log(rt, RT_ERROR, "start time %.9g s, stop time %.9g s: times must be finite and in order", start_time,
               stop_defined ? stop_time : INFINITY);
        return RT_ERROR;
    }
    rt->s.start_time = rt->s.time = rt->s.last_success = start_time;
    rt->s.stop_defined = stop_defined;
    rt->s.stop_time = stop_time;
    return RT_OK;
}

/* The last instant as the system's steps add it up, which may lie beyond the importer's by a rounding. */
static double latest(const Container *c)
{
    double stop = c->rt.s.stop_time, steps = nearbyint((stop - c->rt.s.start_time) / c->step_size);
    if (!c->rt.s.stop_defined || !(steps >= 1) || steps > 9e15) return stop;
    return fmax(stop, time_at(c, (long long)steps - 1) + c->step_size);
}

RtStatus rt_enter_initialization(Runtime *rt)
{
    Container *c = container(rt);
    double stop = latest(c);
    RtStatus status = RT_OK;
    for (int i = 0; i < c->n_inner && status <= RT_WARNING; i++) {
        Inner *inner = &c->inner[i];
        /* Ends of own steps are rounded once more. */
        double own = inner->every != 1 || inner->parts != 1 ? stop + 4 * DBL_EPSILON * fabs(stop) : stop;
        status = inner_enter(inner, rt->s.start_time, (int)rt->s.stop_defined, own);
    }
    if (status > RT_WARNING) return broken(c, "EnterInitializationMode");
    rt->s.phase = PHASE_INITIALIZATION;
    *c->stale = 1;
    return RT_OK;
}

RtStatus rt_exit_initialization(Runtime *rt)
{
    Container *c = container(rt);
    RtStatus status = *c->stale != 0 ? pass_initial_values(c) : RT_OK;
    for (int i = 0; i < c->n_inner && status <= RT_WARNING; i++) status = inner_call(&c->inner[i], CALL_EXIT);
    if (status <= RT_WARNING) status = read_signals(c);
    if (status <= RT_WARNING) status = accept_signals(c, rt->s.start_time);
    if (status > RT_WARNING) return broken(c, "ExitInitializationMode");
    rt->s.phase = PHASE_STEP;
    return RT_OK;
}

static const Variable *typed(Container *c, const char *call, unsigned reference, ModelType type)
{
    static const char *const names[] = {"Real", "Integer", "Boolean"};
    if (reference >= (unsigned)c->n_variables) {
        rt_log(&c->rt, RT_ERROR, "%s: unknown value reference %u; %s has 0 to %d", call, reference, c->name,
               c->n_variables - 1);
    } else if (c->variables[reference].type != type) {
        rt_log(&c->rt, RT_ERROR, "%s: %s (value reference %u) is of type %s, not %s", call,
               c->variables[reference].name, reference, names[c->variables[reference].type], names[type]);
    } else {
        return &c->variables[reference];
    }
    return NULL;
}

/* During initialisation signals answer at once; after it they are those of the last step's end. */
RtStatus rt_get(Runtime *rt, unsigned reference, ModelType type, double *value)
{
    Container *c = container(rt);
    const Variable *v = typed(c, "Get", reference, type);
    if (!v) return RT_ERROR;
    switch (v->kind) {
    case VARIABLE_TIME: *value = rt->s.time; return RT_OK;
    case VARIABLE_INPUT: *value = c->externals[v->place]; return RT_OK;
    case VARIABLE_PARAMETER:
        return inner_get(c, &v->at, value) > RT_WARNING ? rt_report(rt, "Get") : RT_OK;
    default: break;
    }
    if (rt->s.phase == PHASE_INITIALIZATION && *c->stale != 0 &&
        (pass_initial_values(c) > RT_WARNING || read_signals(c) > RT_WARNING))
        return rt_report(rt, "Get");
    *value = c->signals[v->place];
    return RT_OK;
}

RtStatus rt_set(Runtime *rt, unsigned reference, ModelType type, double value)
{
    Container *c = container(rt);
    const Variable *v = typed(c, "Set", reference, type);
    int before = (rt->s.phase & (PHASE_INSTANTIATED | PHASE_INITIALIZATION)) != 0;
    if (!v) return RT_ERROR;
    if (v->kind != VARIABLE_INPUT && v->kind != VARIABLE_PARAMETER) {
        rt_log(rt, RT_ERROR, "Set: %s (value reference %u) cannot be set; inputs and parameters can", v->name,
               reference);
        return RT_ERROR;
    }
    if (v->kind == VARIABLE_PARAMETER && !v->tunable && !before) {
        rt_log(rt, RT_ERROR, "Set: %s is a fixed parameter: it can be set before the end of initialisation only",
               v->name);
        return RT_ERROR;
    }
    if (!isfinite(value)) {
        rt_log(rt, RT_ERROR, "Set: %s cannot be %g; give a finite number", v->name, value);
        return RT_ERROR;
    }
    if (v->kind == VARIABLE_INPUT) c->externals[v->place] = value;
    /* An input is passed on with the next step, as the master passes on the others. */
    if (v->kind == VARIABLE_INPUT && !before) return RT_OK;
    *c->stale = 1;
    return inner_set(c, &v->at, value) > RT_WARNING ? rt_report(rt, "Set") : RT_OK;
}

RtStatus rt_set_input_derivative(Runtime *rt, unsigned reference, int order, double value)
{
    (void)reference, (void)order, (void)value;
    rt_log(rt, RT_ERROR, "SetRealInputDerivatives: inputs are held (canInterpolateInputs is false)");
    return RT_ERROR;
}

static RtStatus no_derivatives(Runtime *rt)
{
    rt_log(rt, RT_ERROR, "a system has no directional derivatives");
    return RT_ERROR;
}

RtStatus rt_directional(Runtime *rt, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                        size_t n_knowns, const double *seed, double *sensitivity)
{
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)sensitivity;
    return no_derivatives(rt);
}

RtStatus rt_adjoint(Runtime *rt, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                    size_t n_knowns, const double *seed, double *sensitivity)
{
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)sensitivity;
    return no_derivatives(rt);
}

/* The number of the system's steps in an importer's; 0, with the trouble noted, if that is none. */
static long long steps_in(Container *c, double point, double size)
{
    double now = c->rt.s.time, own = c->step_size, steps = nearbyint(size / own);
    /* A master that sums its steps up may be off by rounding errors. */
    double close = 1e-3 * own + 16 * DBL_EPSILON * fabs(now);
    if (!isfinite(size) || !isfinite(point) || !(size > 0)) {
        rt_fail(&c->rt, RT_ERROR, "from %.9g s by %.9g s: both have to be finite, the step size above 0 s", point,
                size);
    } else if (fabs(point - now) > close) {
        rt_fail(&c->rt, RT_ERROR, "from %.17g s: the system is at %.17g s", point, now);
    } else if (steps < 1 || fabs(size - steps * own) > 1e-6 * own + 16 * DBL_EPSILON * fabs(now)) {
        rt_fail(&c->rt, RT_ERROR,
                "by %.17g s, which is %.9g of the system's own steps of %.17g s; only whole multiples of that are "
                "possible",
                size, size / own, own);
    } else {
        return (long long)steps;
    }
    return 0;
}

RtStatus rt_do_step(Runtime *rt, double point, double size)
{
    Container *c = container(rt);
    long long steps = steps_in(c, point, size);
    RtStatus worst = RT_OK;
    /* A refusal changes nothing: the instance can go on. */
    if (!steps) return rt_report(rt, "DoStep");
    for (long long i = 0; i < steps; i++) {
        RtStatus status = take_step(c);
        if (status > RT_WARNING) return broken(c, "DoStep");
        if (status > worst) worst = status;
        rt->s.time = rt->s.last_success = time_at(c, (long long)*c->index);
    }
    return worst;
}
