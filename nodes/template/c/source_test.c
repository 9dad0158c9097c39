/* Tests my_plugin.c without Osteoflow: `make test`, which writes a file into build/. */
#include "my_plugin.c"

static const char *const PATH = "build/test.xyz";

/* Whether a file with this text gives `n` points, or a message that ends so. */
static int gives(const char *text, uint64_t n, const char *ending) {
    FILE *file = fopen(PATH, "w");
    if (file == NULL || fputs(text, file) < 0 || fclose(file) != 0) {
        return 0;
    }
    char message[256] = "";
    uint64_t found = 0;
    double *points = read_points(PATH, 1000.0, &found, message, sizeof message);
    const size_t length = strlen(message), end = strlen(ending);
    const int good = points != NULL ? found == n && points[0] == 1000.0 && points[2] == -300.0 && n > 0
                                    : n == 0 && length >= end && strcmp(message + length - end, ending) == 0;
    if (!good) {
        printf("%s: found %llu points, expected %llu; %s\n", text, (unsigned long long)found, (unsigned long long)n, message);
    }
    free(points);
    return good;
}

int main(void) {
    int good = gives("# x y z\n1 2.5 -0.3\n\n 4\t5 6 # the last\r\n", 2, "");
    good &= gives("1 2 3\n4 5\n", 0, "test.xyz:2: three numbers are expected, found \"4 5\"");
    good &= gives("1 2 3\n4 5 nan\n", 0, "test.xyz:2: three numbers are expected, found \"4 5 nan\"");
    good &= gives("1 2 3 4\n", 0, "test.xyz:1: three numbers are expected, found \"1 2 3 4\"");
    good &= gives("1 2 3\n4 5 6", 0, "test.xyz:2: the last line does not end, or is too long; is the file whole?");
    good &= gives("# none\n", 0, "test.xyz:1: the file has no points");
    remove(PATH);
    good &= osteoflow_describe()->n_kinds == 1;
    puts(good ? "passed" : "failed");
    return good ? 0 : 1;
}
