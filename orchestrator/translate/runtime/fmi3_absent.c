/* The functions of FMI 3.0 that a co-simulation FMU exports but need not offer: they say so. */
#include "fmi3Functions.h"
#include "runtime.h"

static fmi3Status absent(fmi3Instance instance, const char *call, const char *reason)
{
    if (instance) rt_log(instance, RT_ERROR, "%s: %s", call, reason);
    return fmi3Error;
}

static const char MODEL_EXCHANGE[] = "belongs to Model Exchange, which is not offered";
static const char EVENT_MODE[] = "belongs to Event Mode, which is not offered (hasEventMode is false)";
static const char CLOCKS[] = "there are no Clock variables";
static const char STRUCTURE[] = "there are no structural parameters";

/* Types without variables; asking for none of them is fine. */
#define NO_VARIABLES(call, type)                                                                           \
    fmi3Status call(fmi3Instance instance, const fmi3ValueReference valueReferences[],                     \
                    size_t nValueReferences, type values[], size_t nValues)                                \
    {                                                                                                      \
        (void)valueReferences;                                                                             \
        (void)values;                                                                                      \
        (void)nValues;                                                                                     \
        return nValueReferences ? absent(instance, #call, "there are no variables of this type") : fmi3OK; \
    }

NO_VARIABLES(fmi3GetFloat32, fmi3Float32)
NO_VARIABLES(fmi3GetInt8, fmi3Int8)
NO_VARIABLES(fmi3GetUInt8, fmi3UInt8)
NO_VARIABLES(fmi3GetInt16, fmi3Int16)
NO_VARIABLES(fmi3GetUInt16, fmi3UInt16)
NO_VARIABLES(fmi3GetUInt32, fmi3UInt32)
NO_VARIABLES(fmi3GetInt64, fmi3Int64)
NO_VARIABLES(fmi3GetUInt64, fmi3UInt64)
NO_VARIABLES(fmi3GetString, fmi3String)
NO_VARIABLES(fmi3SetFloat32, const fmi3Float32)
NO_VARIABLES(fmi3SetInt8, const fmi3Int8)
NO_VARIABLES(fmi3SetUInt8, const fmi3UInt8)
NO_VARIABLES(fmi3SetInt16, const fmi3Int16)
NO_VARIABLES(fmi3SetUInt16, const fmi3UInt16)
NO_VARIABLES(fmi3SetUInt32, const fmi3UInt32)
NO_VARIABLES(fmi3SetInt64, const fmi3Int64)
NO_VARIABLES(fmi3SetUInt64, const fmi3UInt64)
NO_VARIABLES(fmi3SetString, const fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return nValueReferences ? absent(instance, "fmi3GetBinary", "there are no variables of this type")
                            : fmi3OK;
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, const size_t valueSizes[], const fmi3Binary values[],
                         size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return nValueReferences ? absent(instance, "fmi3SetBinary", "there are no variables of this type")
                            : fmi3OK;
}

/* Clock functions with one or two arrays of values. */
#define NO_CLOCK(call, type)                                                           \
    fmi3Status call(fmi3Instance instance, const fmi3ValueReference valueReferences[], \
                    size_t nValueReferences, type values[])                            \
    {                                                                                  \
        (void)valueReferences;                                                         \
        (void)values;                                                                  \
        return nValueReferences ? absent(instance, #call, CLOCKS) : fmi3OK;            \
    }

#define NO_CLOCK_PAIR(call, first_type, second_type)                                   \
    fmi3Status call(fmi3Instance instance, const fmi3ValueReference valueReferences[], \
                    size_t nValueReferences, first_type first[], second_type second[]) \
    {                                                                                  \
        (void)valueReferences;                                                         \
        (void)first;                                                                   \
        (void)second;                                                                  \
        return nValueReferences ? absent(instance, #call, CLOCKS) : fmi3OK;            \
    }

NO_CLOCK(fmi3GetClock, fmi3Clock)
NO_CLOCK(fmi3SetClock, const fmi3Clock)
NO_CLOCK(fmi3GetShiftDecimal, fmi3Float64)
NO_CLOCK(fmi3SetIntervalDecimal, const fmi3Float64)
NO_CLOCK(fmi3SetShiftDecimal, const fmi3Float64)
NO_CLOCK_PAIR(fmi3GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
NO_CLOCK_PAIR(fmi3GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_CLOCK_PAIR(fmi3SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCK_PAIR(fmi3SetShiftFraction, const fmi3UInt64, const fmi3UInt64)

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return nValueReferences ? absent(instance, "fmi3GetIntervalFraction", CLOCKS) : fmi3OK;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    (void)valueReference;
    (void)nDependencies;
    return absent(instance, "fmi3GetNumberOfVariableDependencies",
                  "dependencies do not change; modelDescription.xml has them (providesPerElementDependencies "
                  "is false)");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[],
                                       fmi3DependencyKind dependencyKinds[], size_t nDependencies)
{
    (void)dependent;
    (void)elementIndicesOfDependent;
    (void)independents;
    (void)elementIndicesOfIndependents;
    (void)dependencyKinds;
    (void)nDependencies;
    return absent(instance, "fmi3GetVariableDependencies",
                  "dependencies do not change; modelDescription.xml has them (providesPerElementDependencies "
                  "is false)");
}

#define NO_MODE(call, reason)                   \
    fmi3Status call(fmi3Instance instance)      \
    {                                           \
        return absent(instance, #call, reason); \
    }

NO_MODE(fmi3EnterEventMode, EVENT_MODE)
NO_MODE(fmi3EnterStepMode, EVENT_MODE)
NO_MODE(fmi3EvaluateDiscreteStates, EVENT_MODE)
NO_MODE(fmi3EnterConfigurationMode, STRUCTURE)
NO_MODE(fmi3ExitConfigurationMode, STRUCTURE)
NO_MODE(fmi3EnterContinuousTimeMode, MODEL_EXCHANGE)

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
{
    (void)discreteStatesNeedUpdate;
    (void)terminateSimulation;
    (void)nominalsOfContinuousStatesChanged;
    (void)valuesOfContinuousStatesChanged;
    (void)nextEventTimeDefined;
    (void)nextEventTime;
    return absent(instance, "fmi3UpdateDiscreteStates", EVENT_MODE);
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    (void)enterEventMode;
    (void)terminateSimulation;
    return absent(instance, "fmi3CompletedIntegratorStep", MODEL_EXCHANGE);
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    (void)time;
    return absent(instance, "fmi3SetTime", MODEL_EXCHANGE);
}

#define NO_ARRAY(call, type)                                        \
    fmi3Status call(fmi3Instance instance, type values[], size_t n) \
    {                                                               \
        (void)values;                                               \
        (void)n;                                                    \
        return absent(instance, #call, MODEL_EXCHANGE);             \
    }

NO_ARRAY(fmi3SetContinuousStates, const fmi3Float64)
NO_ARRAY(fmi3GetContinuousStateDerivatives, fmi3Float64)
NO_ARRAY(fmi3GetEventIndicators, fmi3Float64)
NO_ARRAY(fmi3GetContinuousStates, fmi3Float64)
NO_ARRAY(fmi3GetNominalsOfContinuousStates, fmi3Float64)

#define NO_NUMBER(call)                                    \
    fmi3Status call(fmi3Instance instance, size_t *number) \
    {                                                      \
        (void)number;                                      \
        return absent(instance, #call, MODEL_EXCHANGE);    \
    }

NO_NUMBER(fmi3GetNumberOfEventIndicators)
NO_NUMBER(fmi3GetNumberOfContinuousStates)

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return absent(instance, "fmi3ActivateModelPartition", "Scheduled Execution is not offered");
}
