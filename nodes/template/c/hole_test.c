/* Tests my_plugin.c without Osteoflow: `make test`. */
#include "my_plugin.c"

static int same(uint64_t found, uint64_t expected, const char *what) {
    if (found != expected) {
        printf("%s: found %llu, expected %llu\n", what, (unsigned long long)found, (unsigned long long)expected);
    }
    return found == expected;
}

int main(void) {
    /* A row of ten points, of which the other scan lacks the first and those from 4 to 6. */
    double all[30] = { 0 }, left[18] = { 0 };
    uint64_t n_left = 0;
    for (int i = 0; i < 10; i++) {
        all[3 * i] = i;
        if (i > 0 && (i < 4 || i > 6)) {
            left[3 * n_left++] = i;
        }
    }
    const double *missing[10];
    uint64_t first = 10;
    int good = same(find_missing(all, 10, left, n_left, 0.5, missing), 4, "missing points");
    good &= same(largest_patch(missing, 4, 1.5, &first), 3, "points of the hole");
    good &= same(first, 1, "its first point") && same((uint64_t)missing[first][0], 4, "x of it");
    good &= same(find_missing(all, 10, all, 10, 0.5, missing), 0, "missing points of the same scan");
    good &= same(find_missing(all, 10, left, 0, 0.5, missing), 10, "missing points of an empty scan");
    good &= same(largest_patch(missing, 0, 1.5, &first), 0, "the hole of no points");
    good &= same(osteoflow_describe()->n_kinds, 1, "kinds");
    puts(good ? "passed" : "failed");
    return good ? 0 : 1;
}
