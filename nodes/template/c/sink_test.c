/* Tests my_plugin.c without Osteoflow: `make test`, which writes a file into build/. */
#include "my_plugin.c"

int main(void) {
    const char *const path = "build/test.xyz";
    const double points[] = { 1.0 / 3.0, -0.0, 1e-300, 1000.0, 2.0, 3.0 };
    int good = write_points(path, osteoflow_text_of("ct"), 1.0, points, 2);
    FILE *file = fopen(path, "r");
    char line[256] = "";
    good &= file != NULL && fgets(line, sizeof line, file) != NULL && strcmp(line, "# frame ct, unit 1 mm\n") == 0;
    for (int i = 0; good && i < 6; i++) {
        double found = NAN;
        good = fscanf(file, "%lf", &found) == 1 && memcmp(&found, points + i, sizeof found) == 0;
    }
    good &= file != NULL && fscanf(file, "%255s", line) == EOF;
    good &= !write_points("build/no/folder.xyz", osteoflow_text_of("ct"), 1.0, points, 2);
    good &= osteoflow_describe()->n_kinds == 1;
    if (file != NULL) {
        fclose(file);
    }
    remove(path);
    puts(good ? "passed" : "failed");
    return good ? 0 : 1;
}
