/* FMI 3.0 for Co-Simulation with early return, and Model Exchange: what differs from runtime/fmi3.c (as
 * fmi3_steps.h) and runtime/fmi3_absent.c (as fmi3_refusals.h). */
#include <math.h>

#include "fmi3Functions.h"

#include "exchange.h"

/* The functions that are replaced below go by other names in those files. */
#undef fmi3InstantiateCoSimulation
#undef fmi3InstantiateModelExchange
#undef fmi3Reset
#undef fmi3DoStep
#undef fmi3EnterEventMode
#undef fmi3UpdateDiscreteStates
#undef fmi3EnterContinuousTimeMode
#undef fmi3CompletedIntegratorStep
#undef fmi3SetTime
#undef fmi3SetContinuousStates
#undef fmi3GetContinuousStateDerivatives
#undef fmi3GetEventIndicators
#undef fmi3GetContinuousStates
#undef fmi3GetNominalsOfContinuousStates
#undef fmi3GetNumberOfEventIndicators
#undef fmi3GetNumberOfContinuousStates
#define fmi3InstantiateCoSimulation steps_instantiate
#define fmi3InstantiateModelExchange refused_instantiate
#define fmi3Reset steps_reset
#define fmi3DoStep steps_do_step
#define fmi3EnterEventMode refused_event_mode
#define fmi3UpdateDiscreteStates refused_update
#define fmi3EnterContinuousTimeMode refused_continuous
#define fmi3CompletedIntegratorStep refused_completed
#define fmi3SetTime refused_time
#define fmi3SetContinuousStates refused_set_states
#define fmi3GetContinuousStateDerivatives refused_derivatives
#define fmi3GetEventIndicators refused_indicators
#define fmi3GetContinuousStates refused_states
#define fmi3GetNominalsOfContinuousStates refused_nominals
#define fmi3GetNumberOfEventIndicators refused_number_of_indicators
#define fmi3GetNumberOfContinuousStates refused_number_of_states
#include "fmi3_steps.h"
#include "fmi3_refusals.h"
#undef fmi3InstantiateCoSimulation
#undef fmi3InstantiateModelExchange
#undef fmi3Reset
#undef fmi3DoStep
#undef fmi3EnterEventMode
#undef fmi3UpdateDiscreteStates
#undef fmi3EnterContinuousTimeMode
#undef fmi3CompletedIntegratorStep
#undef fmi3SetTime
#undef fmi3SetContinuousStates
#undef fmi3GetContinuousStateDerivatives
#undef fmi3GetEventIndicators
#undef fmi3GetContinuousStates
#undef fmi3GetNominalsOfContinuousStates
#undef fmi3GetNumberOfEventIndicators
#undef fmi3GetNumberOfContinuousStates

#define ENTER_EXCHANGE(call, phases, uses) \
    Runtime *rt = instance;                \
    if (!rt || !me_legal(rt, call, phases, uses)) return fmi3Error

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    Runtime *rt = steps_instantiate(instanceName, instantiationToken, resourcePath, visible, loggingOn,
                                    eventModeUsed, earlyReturnAllowed, requiredIntermediateVariables,
                                    nRequiredIntermediateVariables, instanceEnvironment, logMessage,
                                    intermediateUpdate);
    if (rt && earlyReturnAllowed) me_begin(rt, USE_EARLY_RETURN);
    return rt;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    Runtime *rt = steps_instantiate(instanceName, instantiationToken, resourcePath, visible, loggingOn,
                                    fmi3False, fmi3False, NULL, 0, instanceEnvironment, logMessage, NULL);
    if (rt) me_begin(rt, USE_EVENT_MODE);
    return rt;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    ENTER("fmi3Reset", ANY);
    HybridUse use = me_use(rt);
    fmi3Status status = steps_reset(instance);
    me_begin(rt, use > 0 ? USE_EVENT_MODE : use);
    return status;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    StepEnd end;
    ENTER_EXCHANGE("fmi3DoStep", STEP, IN_STEPS);
    (void)noSetFMUStatePriorToCurrentPoint;
    NOT_NULL("fmi3DoStep", eventHandlingNeeded);
    NOT_NULL("fmi3DoStep", terminateSimulation);
    NOT_NULL("fmi3DoStep", earlyReturn);
    NOT_NULL("fmi3DoStep", lastSuccessfulTime);
    RtStatus status = me_do_step(rt, currentCommunicationPoint, communicationStepSize, &end);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = end.terminated != 0;
    *earlyReturn = end.early != 0;
    *lastSuccessfulTime = rt->s.last_success;
    return end.terminated ? fmi3OK : (fmi3Status)status;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    ENTER_EXCHANGE("fmi3EnterEventMode", STEP, IN_EXCHANGE);
    return (fmi3Status)me_enter(rt, USE_EVENT_MODE);
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    ENTER_EXCHANGE("fmi3EnterContinuousTimeMode", STEP, IN_EVENT_MODE);
    return (fmi3Status)me_enter(rt, USE_CONTINUOUS_TIME);
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
{
    ExchangeEvent event = {0};
    ENTER_EXCHANGE("fmi3UpdateDiscreteStates", STEP, IN_EVENT_MODE);
    NOT_NULL("fmi3UpdateDiscreteStates", discreteStatesNeedUpdate);
    NOT_NULL("fmi3UpdateDiscreteStates", terminateSimulation);
    NOT_NULL("fmi3UpdateDiscreteStates", nominalsOfContinuousStatesChanged);
    NOT_NULL("fmi3UpdateDiscreteStates", valuesOfContinuousStatesChanged);
    NOT_NULL("fmi3UpdateDiscreteStates", nextEventTimeDefined);
    NOT_NULL("fmi3UpdateDiscreteStates", nextEventTime);
    RtStatus status = me_update(rt, &event);
    *discreteStatesNeedUpdate = *nominalsOfContinuousStatesChanged = fmi3False;
    *terminateSimulation = event.terminate != 0;
    *valuesOfContinuousStatesChanged = event.states_changed != 0;
    *nextEventTimeDefined = isfinite(event.next) != 0;
    *nextEventTime = isfinite(event.next) ? event.next : 0;
    return (fmi3Status)status;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    ExchangeEvent event = {0};
    ENTER_EXCHANGE("fmi3CompletedIntegratorStep", STEP, IN_CONTINUOUS_TIME);
    NOT_NULL("fmi3CompletedIntegratorStep", enterEventMode);
    NOT_NULL("fmi3CompletedIntegratorStep", terminateSimulation);
    (void)noSetFMUStatePriorToCurrentPoint;
    RtStatus status = me_step_completed(rt, &event);
    *enterEventMode = event.wanted != 0;
    *terminateSimulation = event.terminate != 0;
    return (fmi3Status)status;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    ENTER_EXCHANGE("fmi3SetTime", STEP, IN_EXCHANGE);
    return (fmi3Status)me_set_time(rt, time);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    ENTER_EXCHANGE("fmi3SetContinuousStates", STEP, IN_CONTINUOUS_TIME);
    ARRAY("fmi3SetContinuousStates", continuousStates, nContinuousStates);
    return (fmi3Status)me_set_states(rt, "fmi3SetContinuousStates", continuousStates, nContinuousStates);
}

#define FILLED(call, function, phases)                                   \
    fmi3Status call(fmi3Instance instance, fmi3Float64 values[], size_t n) \
    {                                                                    \
        ENTER_EXCHANGE(#call, phases, IN_EXCHANGE);                      \
        ARRAY(#call, values, n);                                         \
        return (fmi3Status)function(rt, #call, values, n);               \
    }

FILLED(fmi3GetContinuousStateDerivatives, me_derivatives, READABLE)
FILLED(fmi3GetEventIndicators, me_indicators, READABLE)
FILLED(fmi3GetContinuousStates, me_states, READABLE)
FILLED(fmi3GetNominalsOfContinuousStates, me_nominals, ANY)

#define NUMBER(call, value)                                \
    fmi3Status call(fmi3Instance instance, size_t *number) \
    {                                                      \
        ENTER(#call, ANY);                                 \
        NOT_NULL(#call, number);                           \
        *number = (size_t)(value);                         \
        return fmi3OK;                                     \
    }

NUMBER(fmi3GetNumberOfEventIndicators, hybrid_info.n_margins)
NUMBER(fmi3GetNumberOfContinuousStates, hybrid_info.n_states)
