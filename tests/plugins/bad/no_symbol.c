/* A library, but no plugin. */
int osteoflow_something_else(void) {
    return 0;
}
