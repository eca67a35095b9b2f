/* Messages to the importer, and the checks whose only effect is a message. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "runtime.h"

static const char *const CATEGORIES[] = {"logStatusWarning", "logStatusDiscard", "logStatusError",
                                         "logEvents"};
enum { N_CATEGORIES = 4, EVENTS = 3 };

static void send(Runtime *rt, RtStatus status, int category, const char *format, va_list arguments)
{
    char text[768];
    vsnprintf(text, sizeof text, format, arguments);
    if (rt->emit) rt->emit(rt, status, CATEGORIES[category], text);
}

/* What is not right is told whether debug logging is on or not: a status alone helps nobody. */
void rt_log(Runtime *rt, RtStatus status, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    send(rt, status, status == RT_WARNING ? 0 : status == RT_DISCARD ? 1 : 2, format, arguments);
    va_end(arguments);
}

void rt_log_event(Runtime *rt, const char *format, ...)
{
    va_list arguments;
    if (!rt->logging || (rt->n_categories && !(rt->categories & (1u << EVENTS)))) return;
    va_start(arguments, format);
    send(rt, RT_OK, EVENTS, format, arguments);
    va_end(arguments);
}

int rt_fail(Runtime *rt, RtStatus status, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    rt->trouble = status;
    vsnprintf(rt->trouble_text, sizeof rt->trouble_text, format, arguments);
    va_end(arguments);
    return 1;
}

RtStatus rt_report(Runtime *rt, const char *call)
{
    rt_log(rt, rt->trouble, "%s: %s", call, rt->trouble_text);
    return rt->trouble;
}

RtStatus rt_set_logging(Runtime *rt, int on, size_t n, const char *const *categories)
{
    RtStatus status = RT_OK;
    unsigned chosen = 0;
    for (size_t i = 0; i < n; i++) {
        int known = 0;
        if (!categories || !categories[i]) {
            rt_log(rt, RT_ERROR, "SetDebugLogging: category %d is NULL", (int)i);
            return RT_ERROR;
        }
        for (int c = 0; c < N_CATEGORIES; c++) {
            if (strcmp(categories[i], CATEGORIES[c]) == 0) {
                chosen |= 1u << c;
                known = 1;
            }
        }
        if (!known) {
            rt_log(rt, RT_WARNING, "SetDebugLogging: unknown category %.80s; known: %s, %s, %s, %s",
                   categories[i], CATEGORIES[0], CATEGORIES[1], CATEGORIES[2], CATEGORIES[3]);
            status = RT_WARNING;
        }
    }
    rt->logging = on;
    rt->n_categories = (int)n;
    rt->categories = chosen;
    return status;
}

static const char *phase_name(long long phase)
{
    switch (phase) {
    case PHASE_INSTANTIATED: return "Instantiated";
    case PHASE_INITIALIZATION: return "Initialization Mode";
    case PHASE_STEP: return "Step Mode";
    case PHASE_STEP_DISCARDED: return "Step Discarded";
    case PHASE_TERMINATED: return "Terminated";
    default: return "Error";
    }
}

int rt_legal(Runtime *rt, const char *call, int phases)
{
    if (rt->s.phase & phases) return 1;
    char allowed[128] = "";
    for (int phase = PHASE_INSTANTIATED; phase <= PHASE_ERROR; phase *= 2) {
        if (!(phases & phase)) continue;
        if (allowed[0]) strcat(allowed, ", ");
        strcat(allowed, phase_name(phase));
    }
    rt_log(rt, RT_ERROR, "%s: illegal call in state %s; allowed in: %s", call, phase_name(rt->s.phase),
           allowed);
    return 0;
}

int rt_not_null(Runtime *rt, const char *call, const char *argument, const void *value)
{
    if (value) return 1;
    rt_log(rt, RT_ERROR, "%s: argument %s is NULL", call, argument);
    return 0;
}
