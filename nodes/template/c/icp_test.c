/* Tests my_plugin.c without Osteoflow: `make test`. */
#include "my_plugin.c"

static int near(double found, double expected, const char *what) {
    const int good = fabs(found - expected) < 1e-9;
    if (!good) {
        printf("%s: found %.17g, expected %.17g\n", what, found, expected);
    }
    return good;
}

int main(void) {
    /* The nearest is neither the first nor the last by x. */
    place places[] = { { { 2.0, 0.0, 0.0 }, 0 }, { { 0.0, 0.0, 0.0 }, 1 }, { { 1.4, 3.0, 0.0 }, 2 }, { { 1.0, 0.1, 0.0 }, 3 } };
    const double p[3] = { 1.4, 0.0, 0.0 };
    qsort(places, 4, sizeof *places, by_x);
    int good = near((double)nearest(places, 4, p, 25.0), 3.0, "nearest point");
    good &= near((double)nearest(places, 4, p, 0.16), 4.0, "none within the limit");
    /* A quarter turn about z at (1, 0, 0) takes the origin to (1, -1, 0). */
    double t[7] = { 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0 }, moved[3];
    const double turn[3] = { 0.0, 0.0, acos(0.0) }, shift[3] = { 0.0, 0.0, 7.0 }, centre[3] = { 1.0, 0.0, 0.0 };
    const double origin[3] = { 0.0, 0.0, 0.0 };
    move(t, turn, shift, centre);
    osteoflow_move(t, origin, moved);
    good &= near(moved[0], 1.0, "x") & near(moved[1], -1.0, "y") & near(moved[2], 7.0, "z");
    /* Three pairs for each axis, all shifted by (1, 2, 3), determine the shift. */
    sums s = { 0 };
    for (int k = 0; k < 9; k++) {
        const double from[3] = { k % 4, (k * 5) % 7, (k * 3) % 5 }, to[3] = { from[0] + 1.0, from[1] + 2.0, from[2] + 3.0 };
        const double normal[3] = { k % 3 == 0, k % 3 == 1, k % 3 == 2 };
        add(&s, from, to, normal, centre);
    }
    double step[6] = { 0 };
    good &= near(solve(s.rows, step), 1.0, "solved");
    good &= near(step[3], 1.0, "shift x") & near(step[4], 2.0, "shift y") & near(step[5], 3.0, "shift z");
    double none[6][7] = { { 0 } };
    good &= near(solve(none, step), 0.0, "nothing determines a motion");
    good &= near((double)osteoflow_describe()->n_kinds, 1.0, "kinds");
    puts(good ? "passed" : "failed");
    return good ? 0 : 1;
}
