/* FMI 2.0 for Co-Simulation on top of the runtime.
 *
 * Which call is legal in which state follows the table of section 4.2.4 of the standard (2.0.4). An
 * illegal call or value returns fmi2Error with a message and changes nothing, so that an importer can go
 * on; a failed step does end in the state Error. Model Exchange is not offered: its functions return
 * fmi2Error (fmi2_absent.c). SetupExperiment may be left out; the start time is then 0.
 */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
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
    Runtime *rt = c;           \
    if (!rt) return fmi2Error; \
    if (!rt_legal(rt, call, phases)) return fmi2Error

#define NOT_NULL(call, argument) \
    if (!rt_not_null(rt, call, #argument, argument)) return fmi2Error

#define ARRAY(call, argument, n) \
    if (n) NOT_NULL(call, argument)

static void tell(const fmi2CallbackFunctions *functions, const char *name, fmi2Status status,
                 const char *category, const char *message)
{
    char escaped[1600];
    size_t n = 0;
    if (!functions || !functions->logger) return;
    /* The logger takes a format: a per cent sign in a name must not be one of a conversion. */
    for (; *message && n + 3 < sizeof escaped; message++) {
        if (*message == '%') escaped[n++] = '%';
        escaped[n++] = *message;
    }
    escaped[n] = 0;
    functions->logger(functions->componentEnvironment, name, status, category, escaped);
}

static void emit(Runtime *rt, RtStatus status, const char *category, const char *message)
{
    tell(rt->functions, rt->instance_name, (fmi2Status)status, category, message);
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    ENTER("fmi2SetDebugLogging", ANY);
    ARRAY("fmi2SetDebugLogging", categories, nCategories);
    return (fmi2Status)rt_set_logging(rt, loggingOn, nCategories, categories);
}

static fmi2Component refuse(const fmi2CallbackFunctions *functions, fmi2String name, const char *message)
{
    tell(functions, name ? name : "?", fmi2Error, "logStatusError", message);
    return NULL;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    Runtime *rt;
    char message[1000] = "fmi2Instantiate: ";
    size_t used = strlen(message);
    (void)visible;
    if (!functions) return NULL;
    if (!instanceName || !instanceName[0])
        return refuse(functions, instanceName, "fmi2Instantiate: the instance name is missing");
    if (fmuType != fmi2CoSimulation)
        return refuse(functions, instanceName,
                      "fmi2Instantiate: only Co-Simulation is offered, not Model Exchange");
    rt = rt_new(instanceName, fmuGUID, fmuResourceLocation, message + used, sizeof message - used);
    if (!rt) return refuse(functions, instanceName, message);
    /* The standard does not say how long the importer keeps the struct. */
    rt->functions = malloc(sizeof *functions);
    if (!rt->functions) {
        rt_free(rt);
        return refuse(functions, instanceName, "fmi2Instantiate: no memory");
    }
    memcpy(rt->functions, functions, sizeof *functions);
    rt->emit = emit;
    rt->logging = loggingOn;
    return rt;
}

void fmi2FreeInstance(fmi2Component c)
{
    rt_free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    ENTER("fmi2SetupExperiment", INSTANTIATED);
    return (fmi2Status)rt_set_up(rt, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    ENTER("fmi2EnterInitializationMode", INSTANTIATED);
    return (fmi2Status)rt_enter_initialization(rt);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    ENTER("fmi2ExitInitializationMode", INITIALIZATION);
    return (fmi2Status)rt_exit_initialization(rt);
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    ENTER("fmi2Terminate", STEP | PHASE_STEP_DISCARDED);
    return (fmi2Status)rt_terminate(rt);
}

fmi2Status fmi2Reset(fmi2Component c)
{
    ENTER("fmi2Reset", ANY);
    return (fmi2Status)rt_reset(rt);
}

/* All values are attempted; the worst status is returned. */
#define GETTER(call, type, model_type)                                                        \
    fmi2Status call(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, type value[]) \
    {                                                                                         \
        RtStatus worst = RT_OK;                                                               \
        ENTER(#call, READABLE);                                                               \
        ARRAY(#call, vr, nvr);                                                                \
        ARRAY(#call, value, nvr);                                                             \
        for (size_t i = 0; i < nvr; i++) {                                                    \
            double number = 0;                                                                \
            RtStatus status = rt_get(rt, vr[i], model_type, &number);                         \
            if (status > worst) worst = status;                                               \
            if (status < RT_DISCARD) value[i] = (type)number;                                 \
        }                                                                                     \
        return (fmi2Status)worst;                                                             \
    }

/* Stops at the first value that cannot be set. */
#define SETTER(call, type, model_type)                                                                   \
    fmi2Status call(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const type value[])      \
    {                                                                                                    \
        ENTER(#call, WRITABLE);                                                                          \
        ARRAY(#call, vr, nvr);                                                                           \
        ARRAY(#call, value, nvr);                                                                        \
        for (size_t i = 0; i < nvr; i++) {                                                               \
            double number = model_type == TYPE_BOOLEAN ? (value[i] != 0 ? 1.0 : 0.0) : (double)value[i]; \
            RtStatus status = rt_set(rt, vr[i], model_type, number);                                     \
            if (status != RT_OK) return (fmi2Status)status;                                              \
        }                                                                                                \
        return fmi2OK;                                                                                   \
    }

GETTER(fmi2GetReal, fmi2Real, TYPE_REAL)
GETTER(fmi2GetInteger, fmi2Integer, TYPE_INTEGER)
GETTER(fmi2GetBoolean, fmi2Boolean, TYPE_BOOLEAN)
SETTER(fmi2SetReal, fmi2Real, TYPE_REAL)
SETTER(fmi2SetInteger, fmi2Integer, TYPE_INTEGER)
SETTER(fmi2SetBoolean, fmi2Boolean, TYPE_BOOLEAN)

static fmi2Status no_strings(Runtime *rt, const char *call, size_t nvr)
{
    if (!nvr) return fmi2OK;
    rt_log(rt, RT_ERROR, "%s: there are no String variables", call);
    return fmi2Error;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    ENTER("fmi2GetString", READABLE);
    (void)vr;
    (void)value;
    return no_strings(rt, "fmi2GetString", nvr);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    ENTER("fmi2SetString", WRITABLE);
    (void)vr;
    (void)value;
    return no_strings(rt, "fmi2SetString", nvr);
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    ENTER("fmi2GetFMUstate", ANY);
    NOT_NULL("fmi2GetFMUstate", FMUstate);
    return (fmi2Status)rt_save(rt, FMUstate);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    ENTER("fmi2SetFMUstate", ANY);
    NOT_NULL("fmi2SetFMUstate", FMUstate);
    return (fmi2Status)rt_restore(rt, FMUstate);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    ENTER("fmi2FreeFMUstate", ANY);
    if (FMUstate) rt_state_free(FMUstate);
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    ENTER("fmi2SerializedFMUstateSize", ANY);
    NOT_NULL("fmi2SerializedFMUstateSize", FMUstate);
    NOT_NULL("fmi2SerializedFMUstateSize", size);
    *size = rt_state_size(FMUstate);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size)
{
    ENTER("fmi2SerializeFMUstate", ANY);
    NOT_NULL("fmi2SerializeFMUstate", FMUstate);
    NOT_NULL("fmi2SerializeFMUstate", serializedState);
    return (fmi2Status)rt_state_write(rt, FMUstate, (unsigned char *)serializedState, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    ENTER("fmi2DeSerializeFMUstate", ANY);
    NOT_NULL("fmi2DeSerializeFMUstate", serializedState);
    NOT_NULL("fmi2DeSerializeFMUstate", FMUstate);
    return (fmi2Status)rt_state_read(rt, (const unsigned char *)serializedState, size, FMUstate);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    ENTER("fmi2GetDirectionalDerivative", READABLE);
    ARRAY("fmi2GetDirectionalDerivative", vUnknown_ref, nUnknown);
    ARRAY("fmi2GetDirectionalDerivative", dvUnknown, nUnknown);
    ARRAY("fmi2GetDirectionalDerivative", vKnown_ref, nKnown);
    ARRAY("fmi2GetDirectionalDerivative", dvKnown, nKnown);
    return (fmi2Status)rt_directional(rt, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown);
}

/* They hold for the coming step and are zero after it, and after setting the input itself. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    ENTER("fmi2SetRealInputDerivatives", WRITABLE);
    ARRAY("fmi2SetRealInputDerivatives", vr, nvr);
    ARRAY("fmi2SetRealInputDerivatives", order, nvr);
    ARRAY("fmi2SetRealInputDerivatives", value, nvr);
    for (size_t i = 0; i < nvr; i++) {
        RtStatus status = rt_set_input_derivative(rt, vr[i], order[i], value[i]);
        if (status != RT_OK) return (fmi2Status)status;
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    ENTER("fmi2GetRealOutputDerivatives", READABLE);
    (void)vr;
    (void)order;
    (void)value;
    if (!nvr) return fmi2OK;
    rt_log(rt, RT_ERROR, "fmi2GetRealOutputDerivatives: maxOutputDerivativeOrder is 0");
    return fmi2Error;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    ENTER("fmi2DoStep", STEP);
    (void)noSetFMUStatePriorToCurrentPoint;
    return (fmi2Status)rt_do_step(rt, currentCommunicationPoint, communicationStepSize);
}

/* Only what a synchronous FMU can know is told: the time reached, and that it does not ask for the end. */
#define NO_STATUS(call, type)                                                       \
    fmi2Status call(fmi2Component c, const fmi2StatusKind s, type *value)           \
    {                                                                               \
        ENTER(#call, STEP | PHASE_STEP_DISCARDED | PHASE_TERMINATED | PHASE_ERROR); \
        (void)value;                                                                \
        rt_log(rt, RT_DISCARD, #call ": status kind %d is not available", (int)s);  \
        return fmi2Discard;                                                         \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    ENTER("fmi2GetRealStatus", STEP | PHASE_STEP_DISCARDED | PHASE_TERMINATED | PHASE_ERROR);
    NOT_NULL("fmi2GetRealStatus", value);
    if (s == fmi2LastSuccessfulTime) {
        *value = rt->s.last_success;
        return fmi2OK;
    }
    rt_log(rt, RT_DISCARD, "fmi2GetRealStatus: status kind %d is not available", (int)s);
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    ENTER("fmi2GetBooleanStatus", STEP | PHASE_STEP_DISCARDED | PHASE_TERMINATED | PHASE_ERROR);
    NOT_NULL("fmi2GetBooleanStatus", value);
    if (s == fmi2Terminated) {
        *value = fmi2False;
        return fmi2OK;
    }
    rt_log(rt, RT_DISCARD, "fmi2GetBooleanStatus: status kind %d is not available", (int)s);
    return fmi2Discard;
}
