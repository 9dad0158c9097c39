/* Tests my_plugin.c without Osteoflow: `make test`. */
#include "my_plugin.c"

static int same(uint64_t found, uint64_t expected, const char *what) {
    if (found != expected) {
        printf("%s: found %llu, expected %llu\n", what, (unsigned long long)found, (unsigned long long)expected);
    }
    return found == expected;
}

int main(void) {
    const sphere self = { { 1.0, 0.0, 0.0 }, 2.0 };
    /* In the centre, on the boundary, just outside, and far away. */
    const double points[] = { 1.0, 0.0, 0.0, 3.0, 0.0, 0.0, 3.0, 0.001, 0.0, -50.0, 7.0, 9.0 };
    uint64_t chosen[4];
    int good = same(choose(&self, points, 4, chosen), 2, "points in the sphere");
    good &= same(chosen[1], 1, "the one on the boundary");
    good &= same(choose(&self, points, 0, chosen), 0, "points of an empty cloud");
    good &= same(osteoflow_describe()->n_kinds, 1, "kinds");
    puts(good ? "passed" : "failed");
    return good ? 0 : 1;
}
