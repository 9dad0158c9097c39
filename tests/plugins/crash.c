/* Ends the process in the way that HOW names, at the second item or when a node is destroyed. */
#include "osteoflow.h"
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <pthread.h>
#include <time.h>

#ifndef HOW
#define HOW "segfault"
#endif

static int calls;
/* Unknown to the compiler, which would refuse to write there. */
static void *volatile nowhere = (void *)8;

static int deeper(volatile int *above) {
    /* Smaller than the page below the stack, which it must not step over. */
    volatile int here[64];
    here[0] = above ? above[0] + 1 : 0;
    return deeper(here) + here[0];
}

static void *fault(void *address) {
    *(volatile int *)address = 1;
    return NULL;
}

static void crash(void) {
    if (strcmp(HOW, "segfault") == 0) {
        fault(nowhere);
    } else if (strcmp(HOW, "abort") == 0) {
        abort();
    } else if (strcmp(HOW, "overflow") == 0) {
        printf("%d\n", deeper(NULL));
    } else if (strcmp(HOW, "thread") == 0) {
        pthread_t thread;
        pthread_create(&thread, NULL, fault, nowhere);
        pthread_join(thread, NULL);
    } else if (strcmp(HOW, "exit") == 0) {
        printf("the last words of the plugin\n");
        exit(0);
    } else if (strcmp(HOW, "hang") == 0) {
        fclose(fopen("hangs", "w"));
        for (;;) {
            struct timespec second = { 1, 0 };
            nanosleep(&second, NULL);
        }
    }
}

static int32_t emit_or_crash(const osteoflow_firing *firing, double value) {
    if (++calls == 2) {
        crash();
    }
    osteoflow_view out = { &value, sizeof value, NULL, 0 };
    return firing->host->emit(firing->run, 0, &out);
}

static void crash_at_end(void *node) {
    (void)node;
    if (strcmp(HOW, "destroy") == 0) {
        fault(nowhere);
    }
}

static int32_t create_or_crash(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params,
                               void **node) {
    (void)firing;
    (void)params;
    if (strcmp(HOW, "create") == 0) {
        fault(nowhere);
    }
    *node = (void *)kind;
    return OSTEOFLOW_OK;
}

#define EMIT emit_or_crash
#define DESTROY crash_at_end
#define CREATE create_or_crash
#include "toy.c"
