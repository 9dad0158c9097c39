/* A function that another library calls. */
int dependency(void);

int dependency(void) {
    return 1;
}
