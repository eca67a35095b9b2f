/* Drives an FMI 2.0 library through everything a model can be asked for, for a memory checker, or times
 * its communication steps:  driver LIBRARY GUID OUTPUT [STEPS STEP_SIZE INPUT]  (value references). */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2FunctionTypes.h"

#define LOAD(name) name##TYPE *name = (name##TYPE *)load(library, #name)
#define CHECK(call)                                                   \
    do {                                                              \
        if ((call) > fmi2Warning) {                                   \
            fprintf(stderr, "line %d: %s failed\n", __LINE__, #call); \
            return 1;                                                 \
        }                                                             \
    } while (0)

static void *load(void *library, const char *name)
{
    void *symbol = dlsym(library, name);
    if (!symbol) {
        fprintf(stderr, "%s is missing\n", name);
        exit(1);
    }
    return symbol;
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...)
{
    va_list arguments;
    (void)environment;
    va_start(arguments, message);
    fprintf(stderr, "%s %d %s: ", instance, (int)status, category);
    vfprintf(stderr, message, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

int main(int count, char **arguments)
{
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    void *library = count > 3 ? dlopen(arguments[1], RTLD_NOW) : NULL;
    if (!library) {
        fprintf(stderr, "cannot load %s\n", count > 3 ? dlerror() : "nothing");
        return 1;
    }
    LOAD(fmi2Instantiate);
    LOAD(fmi2FreeInstance);
    LOAD(fmi2SetupExperiment);
    LOAD(fmi2EnterInitializationMode);
    LOAD(fmi2ExitInitializationMode);
    LOAD(fmi2GetReal);
    LOAD(fmi2SetReal);
    LOAD(fmi2DoStep);
    LOAD(fmi2Terminate);
    LOAD(fmi2Reset);
    LOAD(fmi2GetFMUstate);
    LOAD(fmi2SetFMUstate);
    LOAD(fmi2FreeFMUstate);
    LOAD(fmi2SerializedFMUstateSize);
    LOAD(fmi2SerializeFMUstate);
    LOAD(fmi2DeSerializeFMUstate);
    fmi2ValueReference output = (fmi2ValueReference)atoi(arguments[3]);
    fmi2Real value, sum = 0;

    if (count > 6) {
        long steps = atol(arguments[4]);
        double size = atof(arguments[5]);
        fmi2ValueReference input = (fmi2ValueReference)atoi(arguments[6]);
        fmi2Component c = fmi2Instantiate("timed", fmi2CoSimulation, arguments[2], "", &callbacks, 0, 0);
        struct timespec begin, end;
        if (!c) return 1;
        CHECK(fmi2SetupExperiment(c, 0, 0, 0, 0, 0));
        CHECK(fmi2EnterInitializationMode(c));
        CHECK(fmi2ExitInitializationMode(c));
        clock_gettime(CLOCK_MONOTONIC, &begin);
        for (long i = 0; i < steps; i++) {
            value = (double)(i % 97);
            CHECK(fmi2SetReal(c, &input, 1, &value));
            CHECK(fmi2DoStep(c, (double)i * size, size, fmi2True));
            CHECK(fmi2GetReal(c, &output, 1, &value));
            sum += value;
        }
        clock_gettime(CLOCK_MONOTONIC, &end);
        printf("%.4f us per step (sum %g)\n",
               ((double)(end.tv_sec - begin.tv_sec) * 1e9 + (double)(end.tv_nsec - begin.tv_nsec)) / 1e3 /
                   (double)steps,
               sum);
        fmi2FreeInstance(c);
        return 0;
    }

    fmi2Component one = fmi2Instantiate("one", fmi2CoSimulation, arguments[2], "", &callbacks, 0, 1);
    fmi2Component two = fmi2Instantiate("two", fmi2CoSimulation, arguments[2], "", &callbacks, 0, 0);
    if (!one || !two) return 1;
    if (fmi2Instantiate("other", fmi2CoSimulation, "{wrong}", "", &callbacks, 0, 0)) return 1;
    for (int round = 0; round < 2; round++) {
        fmi2FMUstate state = NULL, early = NULL, copy = NULL;
        size_t size = 0;
        fmi2Byte *bytes;
        double step = 0.013, time;
        fmi2ValueReference wrong = 10000;
        CHECK(fmi2GetFMUstate(one, &early));
        CHECK(fmi2SetupExperiment(one, fmi2True, 1e-6, 0, 0, 0));
        CHECK(fmi2EnterInitializationMode(one));
        CHECK(fmi2GetReal(one, &output, 1, &value));
        CHECK(fmi2ExitInitializationMode(one));
        for (int i = 0; i < 200; i++) {
            CHECK(fmi2DoStep(one, i * step, step, fmi2True));
            CHECK(fmi2GetReal(one, &output, 1, &value));
            if (i == 5 || i == 100) CHECK(fmi2GetFMUstate(one, &state));
        }
        if (fmi2GetReal(one, &wrong, 1, &value) != fmi2Error) return 1;
        CHECK(fmi2SerializedFMUstateSize(one, state, &size));
        bytes = malloc(size);
        CHECK(fmi2SerializeFMUstate(one, state, bytes, size));
        if (fmi2DeSerializeFMUstate(two, bytes, size - 1, &copy) != fmi2Error) return 1;
        CHECK(fmi2DeSerializeFMUstate(two, bytes, size, &copy));
        bytes[size - 3] ^= 1;
        if (fmi2DeSerializeFMUstate(two, bytes, size, &early) != fmi2Error) return 1;
        free(bytes);
        CHECK(fmi2SetFMUstate(two, copy));
        CHECK(fmi2SetFMUstate(one, state));
        for (int i = 101; i < 200; i++) {
            time = i * step;
            CHECK(fmi2DoStep(one, time, step, fmi2True));
            CHECK(fmi2DoStep(two, time, step, fmi2True));
        }
        CHECK(fmi2GetReal(two, &output, 1, &sum));
        if (sum != value) return 1;
        CHECK(fmi2Terminate(one));
        CHECK(fmi2SetFMUstate(one, early));
        CHECK(fmi2FreeFMUstate(one, &early));
        CHECK(fmi2FreeFMUstate(one, &state));
        CHECK(fmi2FreeFMUstate(one, &copy));
        CHECK(fmi2Reset(one));
        CHECK(fmi2Reset(two));
    }
    fmi2FreeInstance(one);
    fmi2FreeInstance(two);
    dlclose(library);
    return 0;
}
