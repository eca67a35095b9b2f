/* What a component that advances in steps gives to the FMI runtime.
 *
 *   x <- step(t, h, x, u, p),  w = g(t, x, u, p)
 *
 * with states x, inputs u, parameters p, computed variables w and the communication step from t to t + h.
 * Of model.h it defines model_info (without delay operators, relations and assertions), model_variables,
 * model_algebraics and model_tangent; d and m of a ModelPoint are not read. All functions are pure.
 */
#ifndef STEPMODEL_H
#define STEPMODEL_H

#include <stddef.h>

#include "model.h"

typedef struct {
    double time;      /* where the step begins; the start time before the first [s] */
    double step_size; /* 0 before the first step [s] */
    const double *x, *u, *p;
} StepPoint;

/* Each writes the new states and returns the number of its outcome: 0 if all is well. */
int step_set_up(const StepPoint *at, double *x);     /* what depends on the start time */
int step_initialise(const StepPoint *at, double *x); /* at the end of initialisation */
int step_advance(const StepPoint *at, double *x);

/* RtStatus of an outcome; from RT_DISCARD on the states stay what they were. */
int step_status(int outcome);

/* A text under construction; what does not fit is left out. */
typedef struct {
    char *characters;
    size_t room, length;
} Text;

/* The message of an outcome other than 0; `name` is the instance's. */
void step_message(int outcome, const StepPoint *at, const char *name, Text *text);

/* text.c */
typedef enum { NUMBER_FLOAT, NUMBER_INT, NUMBER_BOOL } NumberKind;
void text_add(Text *, const char *);
/* As Python prints it: the shortest decimal number that reads back as the same double. */
void text_number(Text *, double value, NumberKind);
void text_format(Text *, const char *format, double value); /* a format of printf for one double */

#endif
