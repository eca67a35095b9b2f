/* Files and shared libraries, on every platform. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#if defined _WIN32
#define FOLDER2 "win64"
#define FOLDER3 "x86_64-windows"
#define SUFFIX ".dll"
#elif defined __APPLE__
#define FOLDER2 "darwin64"
#ifdef __aarch64__
#define FOLDER3 "aarch64-darwin"
#else
#define FOLDER3 "x86_64-darwin"
#endif
#define SUFFIX ".dylib"
#else
#define FOLDER2 "linux64"
#define FOLDER3 "x86_64-linux"
#define SUFFIX ".so"
#endif

static int digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}

/* The path of a file URI, which FMI 2 gives, or of a path, which FMI 3 and lenient importers give; without
 * a separator at its end. NULL: no memory. */
char *file_path(const char *location)
{
    const char *from = location;
    size_t length;
    char *path = malloc(strlen(location) + 2), *to = path;
    int is_uri = strncmp(from, "file:", 5) == 0;
    if (!path) return NULL;
    if (is_uri) {
        from += 5;
        if (strncmp(from, "//", 2) == 0) {
            from += 2;
            while (*from && *from != '/') from++; /* the host, which is this one */
        }
        /* /C:/... */
        if (from[0] == '/' && from[1] && from[2] == ':') from++;
    }
    while (*from) {
        if (is_uri && *from == '%' && digit(from[1]) >= 0 && digit(from[2]) >= 0) {
            *to++ = (char)(16 * digit(from[1]) + digit(from[2]));
            from += 3;
        } else {
            *to++ = *from++;
        }
    }
    *to = 0;
    length = (size_t)(to - path);
    while (length > 1 && (path[length - 1] == '/' || path[length - 1] == '\\')) path[--length] = 0;
    return path;
}

#ifdef _WIN32
static wchar_t *wide(const char *text)
{
    int length = MultiByteToWideChar(CP_UTF8, 0, text, -1, NULL, 0);
    wchar_t *result = length > 0 ? malloc((size_t)length * sizeof *result) : NULL;
    if (result) {
        MultiByteToWideChar(CP_UTF8, 0, text, -1, result, length);
        for (wchar_t *at = result; *at; at++)
            if (*at == L'/') *at = L'\\';
    }
    return result;
}
#endif

/* The whole file with a zero at its end; NULL if it cannot be read. */
char *file_content(const char *path)
{
    char *content = NULL;
    long size;
#ifdef _WIN32
    wchar_t *name = wide(path);
    FILE *file = name ? _wfopen(name, L"rb") : NULL;
    free(name);
#else
    FILE *file = fopen(path, "rb");
#endif
    if (!file) return NULL;
    if (fseek(file, 0, SEEK_END) == 0 && (size = ftell(file)) >= 0 && fseek(file, 0, SEEK_SET) == 0) {
        content = malloc((size_t)size + 1);
        if (content && fread(content, 1, (size_t)size, file) != (size_t)size) {
            free(content);
            content = NULL;
        }
        if (content) content[size] = 0;
    }
    fclose(file);
    return content;
}

static Symbol symbol(void *handle, const char *name)
{
    Symbol found;
#ifdef _WIN32
    FARPROC address = GetProcAddress(handle, name);
#else
    void *address = dlsym(handle, name);
#endif
    memcpy(&found, &address, sizeof found);
    return found;
}

static const char *const NAMES2[N_FUNCTIONS] = {
    "fmi2Instantiate", "fmi2FreeInstance", "fmi2SetupExperiment", "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode", "fmi2DoStep", "fmi2Terminate", "fmi2Reset", "fmi2GetFMUstate",
    "fmi2SetFMUstate", "fmi2FreeFMUstate", "fmi2SerializedFMUstateSize", "fmi2SerializeFMUstate",
    "fmi2DeSerializeFMUstate"};
static const char *const NAMES3[N_FUNCTIONS] = {
    "fmi3InstantiateCoSimulation", "fmi3FreeInstance", NULL, "fmi3EnterInitializationMode",
    "fmi3ExitInitializationMode", "fmi3DoStep", "fmi3Terminate", "fmi3Reset", "fmi3GetFMUState",
    "fmi3SetFMUState", "fmi3FreeFMUState", "fmi3SerializedFMUStateSize", "fmi3SerializeFMUState",
    "fmi3DeserializeFMUState"};
static const char *const TYPES2[N_TYPES] = {"Real", NULL, NULL, NULL, NULL, NULL, "Integer",
                                            NULL,   NULL, NULL, "Boolean", "String"};
static const char *const TYPES3[N_TYPES] = {"Float64", "Float32", "Int8",   "UInt8",  "Int16",   "UInt16",
                                            "Int32",   "UInt32",  "Int64",  "UInt64", "Boolean", "String"};

static int find_functions(Library *library, const char *path, char *why, size_t room)
{
    const char *const *names = library->version == 2 ? NAMES2 : NAMES3;
    const char *const *types = library->version == 2 ? TYPES2 : TYPES3;
    char name[64];
    for (int i = 0; i < N_FUNCTIONS; i++) {
        int needed = i <= CALL_STEP || (library->can_save && i >= CALL_SAVE && i <= CALL_FORGET) ||
                     (library->can_serialise && i >= CALL_SIZE);
        if (!names[i]) continue;
        library->functions[i] = symbol(library->handle, names[i]);
        if (library->functions[i] || !needed) continue;
        snprintf(why, room, "%s has no function %s", path, names[i]);
        return 1;
    }
    for (int i = 0; i < N_TYPES; i++) {
        if (!types[i]) continue;
        snprintf(name, sizeof name, "fmi%dGet%s", library->version, types[i]);
        library->get[i] = symbol(library->handle, name);
        snprintf(name, sizeof name, "fmi%dSet%s", library->version, types[i]);
        library->set[i] = symbol(library->handle, name);
    }
    return 0;
}

/* 0, or 1 with a message. */
int library_load(Library *library, const char *resources, char *why, size_t room)
{
    const char *folder = library->version == 2 ? FOLDER2 : FOLDER3, *reason = "";
    size_t size = strlen(resources) + strlen(library->folder) + strlen(library->identifier) + 64;
    char *path = malloc(size);
    int failed = 1;
    if (!path) {
        snprintf(why, room, "no memory");
        return 1;
    }
    snprintf(path, size, "%s/%s/binaries/%s/%s%s", resources, library->folder, folder, library->identifier,
             SUFFIX);
#ifdef _WIN32
    {
        char code[48];
        wchar_t *name = wide(path);
        /* So that libraries beside it are found. */
        library->handle = name ? (void *)LoadLibraryExW(name, NULL, LOAD_WITH_ALTERED_SEARCH_PATH) : NULL;
        snprintf(code, sizeof code, "error %lu", GetLastError());
        free(name);
        reason = code;
        if (!library->handle) snprintf(why, room, "cannot load %s: %s", path, reason);
    }
#else
    /* Local: every FMU has functions of the same names. */
    library->handle = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library->handle) {
        reason = dlerror();
        snprintf(why, room, "cannot load %s: %s", path, reason ? reason : "");
    }
#endif
    if (library->handle) failed = find_functions(library, path, why, room);
    free(path);
    return failed;
}

void library_unload(Library *library)
{
    if (!library->handle) return;
#ifdef _WIN32
    FreeLibrary(library->handle);
#else
    dlclose(library->handle);
#endif
    library->handle = NULL;
}
