/* FMI 3.0 for Co-Simulation on top of the runtime; scalar variables of type Float64, Int32 and Boolean.
 *
 * Without Event Mode, early return and intermediate update: events are handled inside fmi3DoStep. An
 * illegal call or value returns fmi3Error with a message and changes nothing, so that an importer can go
 * on; a failed step does end in the state Error. What FMI 3.0 has beyond that is in fmi3_absent.c.
 */
#include <string.h>

#include "fmi3Functions.h"
#include "runtime.h"

enum {
    INSTANTIATED = PHASE_INSTANTIATED,
    INITIALIZATION = PHASE_INITIALIZATION,
    STEP = PHASE_STEP,
    READABLE = PHASE_INITIALIZATION | PHASE_STEP | PHASE_STEP_DISCARDED | PHASE_TERMINATED | PHASE_ERROR,
    WRITABLE = PHASE_INSTANTIATED | PHASE_INITIALIZATION | PHASE_STEP,
    ANY = PHASE_INSTANTIATED | READABLE
};

/* Common beginning: an instance, a legal state. */
#define ENTER(call, phases)    \
    Runtime *rt = instance;    \
    if (!rt) return fmi3Error; \
    if (!rt_legal(rt, call, phases)) return fmi3Error

#define NOT_NULL(call, argument) \
    if (!rt_not_null(rt, call, #argument, argument)) return fmi3Error

#define ARRAY(call, argument, n) \
    if (n) NOT_NULL(call, argument)

#define SAME_LENGTH(call, n_values, n)                                                                  \
    if ((n_values) != (n)) {                                                                            \
        rt_log(rt, RT_ERROR, "%s: %d values for %d scalar variables", call, (int)(n_values), (int)(n)); \
        return fmi3Error;                                                                               \
    }

static void emit(Runtime *rt, RtStatus status, const char *category, const char *message)
{
    fmi3LogMessageCallback callback;
    if (!rt->logger) return;
    memcpy(&callback, &rt->logger, sizeof callback);
    callback(rt->environment, (fmi3Status)status, category, message);
}

static fmi3Instance refuse(fmi3LogMessageCallback logMessage, fmi3InstanceEnvironment environment,
                           const char *message)
{
    if (logMessage) logMessage(environment, fmi3Error, "logStatusError", message);
    return NULL;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    ENTER("fmi3SetDebugLogging", ANY);
    ARRAY("fmi3SetDebugLogging", categories, nCategories);
    return (fmi3Status)rt_set_logging(rt, loggingOn, nCategories, categories);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    Runtime *rt;
    char message[1000] = "fmi3InstantiateCoSimulation: ";
    size_t used = strlen(message);
    (void)visible;
    (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables;
    (void)intermediateUpdate;
    if (!instanceName || !instanceName[0])
        return refuse(logMessage, instanceEnvironment,
                      "fmi3InstantiateCoSimulation: the instance name is missing");
    if (eventModeUsed)
        return refuse(logMessage, instanceEnvironment,
                      "fmi3InstantiateCoSimulation: Event Mode is not offered (hasEventMode is false)");
    if (nRequiredIntermediateVariables)
        return refuse(logMessage, instanceEnvironment,
                      "fmi3InstantiateCoSimulation: intermediate update is not offered "
                      "(providesIntermediateUpdate is false)");
    rt = rt_new(instanceName, instantiationToken, resourcePath, message + used, sizeof message - used);
    if (!rt) return refuse(logMessage, instanceEnvironment, message);
    rt->environment = instanceEnvironment;
    memcpy(&rt->logger, &logMessage, sizeof rt->logger);
    rt->emit = emit;
    rt->logging = loggingOn;
    return rt;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    return refuse(logMessage, instanceEnvironment,
                  "fmi3InstantiateModelExchange: only Co-Simulation is offered");
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    return refuse(logMessage, instanceEnvironment,
                  "fmi3InstantiateScheduledExecution: only Co-Simulation is offered");
}

void fmi3FreeInstance(fmi3Instance instance)
{
    rt_free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    RtStatus status;
    ENTER("fmi3EnterInitializationMode", INSTANTIATED);
    status = rt_set_up(rt, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime);
    return (fmi3Status)(status == RT_OK ? rt_enter_initialization(rt) : status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    ENTER("fmi3ExitInitializationMode", INITIALIZATION);
    return (fmi3Status)rt_exit_initialization(rt);
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    ENTER("fmi3Terminate", STEP | PHASE_STEP_DISCARDED);
    return (fmi3Status)rt_terminate(rt);
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    ENTER("fmi3Reset", ANY);
    return (fmi3Status)rt_reset(rt);
}

/* All values are attempted; the worst status is returned. */
#define GETTER(call, type, model_type)                                                 \
    fmi3Status call(fmi3Instance instance, const fmi3ValueReference valueReferences[], \
                    size_t nValueReferences, type values[], size_t nValues)            \
    {                                                                                  \
        RtStatus worst = RT_OK;                                                        \
        ENTER(#call, READABLE);                                                        \
        ARRAY(#call, valueReferences, nValueReferences);                               \
        ARRAY(#call, values, nValueReferences);                                        \
        SAME_LENGTH(#call, nValues, nValueReferences);                                 \
        for (size_t i = 0; i < nValues; i++) {                                         \
            double number = 0;                                                         \
            RtStatus status = rt_get(rt, valueReferences[i], model_type, &number);     \
            if (status > worst) worst = status;                                        \
            if (status < RT_DISCARD) values[i] = (type)number;                         \
        }                                                                              \
        return (fmi3Status)worst;                                                      \
    }

/* Stops at the first value that cannot be set. */
#define SETTER(call, type, model_type)                                                       \
    fmi3Status call(fmi3Instance instance, const fmi3ValueReference valueReferences[],       \
                    size_t nValueReferences, const type values[], size_t nValues)            \
    {                                                                                        \
        ENTER(#call, WRITABLE);                                                              \
        ARRAY(#call, valueReferences, nValueReferences);                                     \
        ARRAY(#call, values, nValueReferences);                                              \
        SAME_LENGTH(#call, nValues, nValueReferences);                                       \
        for (size_t i = 0; i < nValues; i++) {                                               \
            RtStatus status = rt_set(rt, valueReferences[i], model_type, (double)values[i]); \
            if (status != RT_OK) return (fmi3Status)status;                                  \
        }                                                                                    \
        return fmi3OK;                                                                       \
    }

GETTER(fmi3GetFloat64, fmi3Float64, TYPE_REAL)
GETTER(fmi3GetInt32, fmi3Int32, TYPE_INTEGER)
GETTER(fmi3GetBoolean, fmi3Boolean, TYPE_BOOLEAN)
SETTER(fmi3SetFloat64, fmi3Float64, TYPE_REAL)
SETTER(fmi3SetInt32, fmi3Int32, TYPE_INTEGER)
SETTER(fmi3SetBoolean, fmi3Boolean, TYPE_BOOLEAN)

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    ENTER("fmi3GetFMUState", ANY);
    NOT_NULL("fmi3GetFMUState", FMUState);
    return (fmi3Status)rt_save(rt, FMUState);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    ENTER("fmi3SetFMUState", ANY);
    NOT_NULL("fmi3SetFMUState", FMUState);
    return (fmi3Status)rt_restore(rt, FMUState);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    ENTER("fmi3FreeFMUState", ANY);
    if (FMUState) rt_state_free(FMUState);
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    ENTER("fmi3SerializedFMUStateSize", ANY);
    NOT_NULL("fmi3SerializedFMUStateSize", FMUState);
    NOT_NULL("fmi3SerializedFMUStateSize", size);
    *size = rt_state_size(FMUState);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size)
{
    ENTER("fmi3SerializeFMUState", ANY);
    NOT_NULL("fmi3SerializeFMUState", FMUState);
    NOT_NULL("fmi3SerializeFMUState", serializedState);
    return (fmi3Status)rt_state_write(rt, FMUState, serializedState, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    ENTER("fmi3DeserializeFMUState", ANY);
    NOT_NULL("fmi3DeserializeFMUState", serializedState);
    NOT_NULL("fmi3DeserializeFMUState", FMUState);
    return (fmi3Status)rt_state_read(rt, serializedState, size, FMUState);
}

#define DERIVATIVE(call, function, n_in, n_out)                                                   \
    fmi3Status call(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, \
                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],  \
                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)                 \
    {                                                                                             \
        ENTER(#call, READABLE);                                                                   \
        ARRAY(#call, unknowns, nUnknowns);                                                        \
        ARRAY(#call, knowns, nKnowns);                                                            \
        ARRAY(#call, seed, nSeed);                                                                \
        ARRAY(#call, sensitivity, nSensitivity);                                                  \
        SAME_LENGTH(#call ", seed", nSeed, n_in);                                                 \
        SAME_LENGTH(#call ", sensitivity", nSensitivity, n_out);                                  \
        return (fmi3Status)function(rt, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity); \
    }

DERIVATIVE(fmi3GetDirectionalDerivative, rt_directional, nKnowns, nUnknowns)
DERIVATIVE(fmi3GetAdjointDerivative, rt_adjoint, nUnknowns, nKnowns)

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    ENTER("fmi3GetOutputDerivatives", READABLE);
    (void)valueReferences;
    (void)orders;
    (void)values;
    (void)nValues;
    if (!nValueReferences) return fmi3OK;
    rt_log(rt, RT_ERROR, "fmi3GetOutputDerivatives: maxOutputDerivativeOrder is 0");
    return fmi3Error;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    RtStatus status;
    ENTER("fmi3DoStep", STEP);
    (void)noSetFMUStatePriorToCurrentPoint;
    NOT_NULL("fmi3DoStep", eventHandlingNeeded);
    NOT_NULL("fmi3DoStep", terminateSimulation);
    NOT_NULL("fmi3DoStep", earlyReturn);
    NOT_NULL("fmi3DoStep", lastSuccessfulTime);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    status = rt_do_step(rt, currentCommunicationPoint, communicationStepSize);
    *lastSuccessfulTime = rt->s.last_success;
    return (fmi3Status)status;
}
