/* Model exchange on top of the solver: the importer integrates, the model handles events. */
#ifndef EXCHANGE_H
#define EXCHANGE_H

#include "hybrid.h"
#include "runtime.h"
#include "stepmodel.h"

typedef struct {
    int wanted;          /* after a step: an event is to be handled */
    int states_changed;  /* by an event */
    int terminate;
    double next;         /* time of the next event that is known; infinite if there is none [s] */
} ExchangeEvent;

/* hybrid.c; each returns an outcome as those of stepmodel.h, and writes z. */
int exchange_evaluate(const StepPoint *at, double *z, double *margins); /* margins may be NULL */
int exchange_event(const StepPoint *at, double *z, ExchangeEvent *);
int exchange_step_completed(const StepPoint *at, double *z, ExchangeEvent *);

/* exchange.c: what both versions of FMI ask for. `call` is the name of the function, for messages. */
void me_begin(Runtime *, HybridUse);                 /* after instantiation or a reset */
HybridUse me_use(const Runtime *);
int me_legal(Runtime *, const char *call, int phases, int uses); /* uses: bits 1 << HybridUse */
RtStatus me_enter(Runtime *, HybridUse);
RtStatus me_set_time(Runtime *, double);
RtStatus me_set_states(Runtime *, const char *call, const double *x, size_t n);
RtStatus me_states(Runtime *, const char *call, double *x, size_t n);
RtStatus me_nominals(Runtime *, const char *call, double *x, size_t n);
RtStatus me_derivatives(Runtime *, const char *call, double *f, size_t n);
RtStatus me_indicators(Runtime *, const char *call, double *g, size_t n);
RtStatus me_update(Runtime *, ExchangeEvent *);
RtStatus me_step_completed(Runtime *, ExchangeEvent *);
/* A step, up to where the model asks for its end or, if asked for, an event ended it. */
typedef struct { int terminated, early; } StepEnd;
RtStatus me_do_step(Runtime *, double point, double size, StepEnd *);

enum { IN_EVENT_MODE = 1 << USE_EVENT_MODE, IN_CONTINUOUS_TIME = 1 << USE_CONTINUOUS_TIME,
       IN_EXCHANGE = IN_EVENT_MODE | IN_CONTINUOUS_TIME, IN_STEPS = 1 };

#endif
