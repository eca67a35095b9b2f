/* A library that another one needs, which stands beside it in the FMU. */
#if defined(_WIN32)
__declspec(dllexport)
#endif
int helper(void) { return 42; }
