/* Of integrate.c what step.c alone needs: native forms, which hold runtime.h, integrate nothing. */
#ifndef INTEGRATE_H
#define INTEGRATE_H

#include "runtime.h"

/* As rt_attempt, with an error of as many tolerances as `allowed`; INFINITY: whatever is finite. */
Verdict rt_attempt_within(Runtime *, double end, double allowed, double *factor, int *event);

/* Error of the step from t0 to `end`, in tolerances; infinite if it cannot be taken. */
double rt_step_error(Runtime *, double end);

#endif
