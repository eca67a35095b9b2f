/* The functions of FMI 2.0 that a co-simulation FMU exports but need not offer: they say so. */
#include "fmi2Functions.h"
#include "runtime.h"

static fmi2Status absent(fmi2Component c, const char *call, const char *reason)
{
    if (c) rt_log(c, RT_ERROR, "%s: %s", call, reason);
    return fmi2Error;
}

static fmi2Status model_exchange(fmi2Component c, const char *call)
{
    return absent(c, call, "belongs to Model Exchange, which is not offered");
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return absent(c, "fmi2CancelStep", "steps are not asynchronous, there is none to cancel");
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    return model_exchange(c, "fmi2EnterEventMode");
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo)
{
    (void)fmi2eventInfo;
    return model_exchange(c, "fmi2NewDiscreteStates");
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return model_exchange(c, "fmi2EnterContinuousTimeMode");
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    (void)enterEventMode;
    (void)terminateSimulation;
    return model_exchange(c, "fmi2CompletedIntegratorStep");
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    (void)time;
    return model_exchange(c, "fmi2SetTime");
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    (void)x;
    (void)nx;
    return model_exchange(c, "fmi2SetContinuousStates");
}

#define NO_ARRAY(call)                                       \
    fmi2Status call(fmi2Component c, fmi2Real a[], size_t n) \
    {                                                        \
        (void)a;                                             \
        (void)n;                                             \
        return model_exchange(c, #call);                     \
    }

NO_ARRAY(fmi2GetDerivatives)
NO_ARRAY(fmi2GetEventIndicators)
NO_ARRAY(fmi2GetContinuousStates)
NO_ARRAY(fmi2GetNominalsOfContinuousStates)
