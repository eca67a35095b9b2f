/* FMI 2.0 for both kinds: what differs from Co-Simulation alone, around runtime/fmi2.c (as fmi2_steps.h). */
#include <math.h>

#include "fmi2Functions.h"

#include "exchange.h"

/* The functions that are replaced below go by other names in fmi2_steps.h. */
#undef fmi2Instantiate
#undef fmi2Reset
#undef fmi2DoStep
#undef fmi2GetBooleanStatus
#define fmi2Instantiate steps_instantiate
#define fmi2Reset steps_reset
#define fmi2DoStep steps_do_step
#define fmi2GetBooleanStatus steps_boolean_status
#include "fmi2_steps.h"
#undef fmi2Instantiate
#undef fmi2Reset
#undef fmi2DoStep
#undef fmi2GetBooleanStatus

#define ENTER_EXCHANGE(call, phases, uses)                               \
    Runtime *rt = c;                                                     \
    if (!rt || !me_legal(rt, call, phases, uses)) return fmi2Error

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    Runtime *rt = steps_instantiate(instanceName, fmi2CoSimulation, fmuGUID, fmuResourceLocation, functions,
                                    visible, loggingOn);
    if (rt && fmuType == fmi2ModelExchange) me_begin(rt, USE_EVENT_MODE);
    return rt;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    ENTER("fmi2Reset", ANY);
    HybridUse use = me_use(rt);
    fmi2Status status = steps_reset(c);
    me_begin(rt, use > 0 ? USE_EVENT_MODE : use);
    return status;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    StepEnd end;
    ENTER_EXCHANGE("fmi2DoStep", STEP, IN_STEPS);
    (void)noSetFMUStatePriorToCurrentPoint;
    RtStatus status = me_do_step(rt, currentCommunicationPoint, communicationStepSize, &end);
    if (end.terminated) rt->s.phase = PHASE_STEP_DISCARDED;
    return (fmi2Status)status;
}

/* Whether the model asked for the end, where a step was discarded. */
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    fmi2Status status = steps_boolean_status(c, s, value);
    if (status == fmi2OK && s == fmi2Terminated)
        *value = ((Runtime *)c)->x[hybrid_info.ended_slot] != 0 ? fmi2True : fmi2False;
    return status;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    if (c) rt_log(c, RT_ERROR, "fmi2CancelStep: steps are not asynchronous, there is none to cancel");
    return fmi2Error;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    ENTER_EXCHANGE("fmi2EnterEventMode", STEP, IN_EXCHANGE);
    return (fmi2Status)me_enter(rt, USE_EVENT_MODE);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    ENTER_EXCHANGE("fmi2EnterContinuousTimeMode", STEP, IN_EVENT_MODE);
    return (fmi2Status)me_enter(rt, USE_CONTINUOUS_TIME);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo)
{
    ExchangeEvent event = {0};
    ENTER_EXCHANGE("fmi2NewDiscreteStates", STEP, IN_EVENT_MODE);
    NOT_NULL("fmi2NewDiscreteStates", fmi2eventInfo);
    RtStatus status = me_update(rt, &event);
    fmi2eventInfo->newDiscreteStatesNeeded = fmi2False;
    fmi2eventInfo->terminateSimulation = event.terminate ? fmi2True : fmi2False;
    fmi2eventInfo->nominalsOfContinuousStatesChanged = fmi2False;
    fmi2eventInfo->valuesOfContinuousStatesChanged = event.states_changed ? fmi2True : fmi2False;
    fmi2eventInfo->nextEventTimeDefined = isfinite(event.next) ? fmi2True : fmi2False;
    fmi2eventInfo->nextEventTime = isfinite(event.next) ? event.next : 0;
    return (fmi2Status)status;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    ExchangeEvent event = {0};
    ENTER_EXCHANGE("fmi2CompletedIntegratorStep", STEP, IN_CONTINUOUS_TIME);
    NOT_NULL("fmi2CompletedIntegratorStep", enterEventMode);
    NOT_NULL("fmi2CompletedIntegratorStep", terminateSimulation);
    (void)noSetFMUStatePriorToCurrentPoint;
    RtStatus status = me_step_completed(rt, &event);
    *enterEventMode = event.wanted ? fmi2True : fmi2False;
    *terminateSimulation = event.terminate ? fmi2True : fmi2False;
    return (fmi2Status)status;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    ENTER_EXCHANGE("fmi2SetTime", STEP, IN_EXCHANGE);
    return (fmi2Status)me_set_time(rt, time);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    ENTER_EXCHANGE("fmi2SetContinuousStates", STEP, IN_CONTINUOUS_TIME);
    ARRAY("fmi2SetContinuousStates", x, nx);
    return (fmi2Status)me_set_states(rt, "fmi2SetContinuousStates", x, nx);
}

#define FILLED(call, function, phases)                       \
    fmi2Status call(fmi2Component c, fmi2Real a[], size_t n) \
    {                                                        \
        ENTER_EXCHANGE(#call, phases, IN_EXCHANGE);          \
        ARRAY(#call, a, n);                                  \
        return (fmi2Status)function(rt, #call, a, n);        \
    }

FILLED(fmi2GetDerivatives, me_derivatives, READABLE)
FILLED(fmi2GetEventIndicators, me_indicators, READABLE)
FILLED(fmi2GetContinuousStates, me_states, READABLE)
FILLED(fmi2GetNominalsOfContinuousStates, me_nominals, ANY)
