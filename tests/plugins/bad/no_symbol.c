/* A library that is not a plugin. */
int osteoflow_something_else(void) {
    return 0;
}
