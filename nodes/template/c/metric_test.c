/* Tests my_plugin.c without Osteoflow: `make test`. */
#include "my_plugin.c"

static int near(double found, double expected, const char *what) {
    const int good = fabs(found - expected) < 1e-12;
    if (!good) {
        printf("%s: found %.17g, expected %.17g\n", what, found, expected);
    }
    return good;
}

int main(void) {
    /* The true pose turns by a quarter about z, the other one by none; both shift by (1, 2, 3). */
    const double half = sqrt(0.5), truth[7] = { 1.0, 2.0, 3.0, 0.0, 0.0, half, half };
    const double pose[7] = { 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0 }, p[3] = { 4.0, 2.0, 0.0 };
    int good = near(error_mm(truth, truth, p), 0.0, "the true pose");
    good &= near(error_mm(pose, truth, p), 3.0 * sqrt(2.0), "a quarter turn, 3 mm from its axis");
    good &= near((double)osteoflow_describe()->n_kinds, 1.0, "kinds");
    puts(good ? "passed" : "failed");
    return good ? 0 : 1;
}
