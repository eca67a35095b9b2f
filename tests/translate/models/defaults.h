/* What a model does without: define HAS_... before including this to write the function oneself. */
#ifndef DEFAULTS_H
#define DEFAULTS_H

#include "model.h"

#ifndef HAS_DEPENDENTS
void model_dependent_parameters(double *p) { (void)p; }
void model_dependent_starts(const double *p, double *x) { (void)p; (void)x; }
#endif

#ifndef HAS_STATES
void model_derivatives(const ModelPoint *at, double *xdot) { (void)at; (void)xdot; }
#endif

#ifndef HAS_DELAYS
void model_delays(const ModelPoint *at, double *operand, double *delay_time)
{
    (void)at; (void)operand; (void)delay_time;
}
void model_delay_maxima(const double *p, double *maximum) { (void)p; (void)maximum; }
#endif

#ifndef HAS_RELATIONS
const int model_relation_strict[] = {0};
void model_relations(const ModelPoint *at, double *r) { (void)at; (void)r; }
#endif

#ifndef HAS_ASSERTIONS
const char *const model_assertion_messages[] = {""};
const int model_assertion_is_error[] = {0};
void model_assertions(const ModelPoint *at, double *a) { (void)at; (void)a; }
#endif

#endif
