/* The lens of each image as its head says it. Built with IMAGE_VERSION=1 it is a library of before images had distortion. */
#include "osteoflow_geometry.h"

#include <stdio.h>

#ifndef IMAGE_VERSION
#define IMAGE_VERSION OSTEOFLOW_IMAGE_VERSION
#endif

static int32_t lens(void *node, const osteoflow_firing *firing) {
    (void)node;
    osteoflow_view view;
    if (osteoflow_input_view(firing, 0, &view) != OSTEOFLOW_OK) {
        return osteoflow_fail(firing, "the image cannot be read");
    }
    const osteoflow_image *head = view.head;
    char said[256];
    int end = snprintf(said, sizeof said, "%.*s", (int)head->distortion_model.length, head->distortion_model.data);
    for (uint64_t i = 0; i < head->distortion.length; i++) {
        end += snprintf(said + end, sizeof said - (size_t)end, " %g", head->distortion.data[i]);
    }
    const osteoflow_words words = { osteoflow_text_of(said) };
    const osteoflow_view out = { &words, sizeof words, NULL, 0 };
    if (firing->host->emit(firing->run, 0, &out) != OSTEOFLOW_OK) {
        return OSTEOFLOW_FAILED;
    }
    /* The same image, its columns held. */
    const osteoflow_column pixels = osteoflow_held_column(&view.columns[0]);
    const osteoflow_view same = { head, sizeof *head, &pixels, 1 };
    return firing->host->emit(firing->run, 1, &same);
}

static const osteoflow_input in[] = {
    { .name = OSTEOFLOW_TEXT("image"), .doc = OSTEOFLOW_TEXT("An image."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_IMAGE),
      .version = IMAGE_VERSION },
};
static const osteoflow_output out[] = {
    { .name = OSTEOFLOW_TEXT("text"), .doc = OSTEOFLOW_TEXT("Its lens."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_WORDS),
      .version = OSTEOFLOW_WORDS_VERSION },
    { .name = OSTEOFLOW_TEXT("image"), .doc = OSTEOFLOW_TEXT("The same."), .payload = OSTEOFLOW_TEXT(OSTEOFLOW_IMAGE),
      .version = IMAGE_VERSION },
};

static int32_t create(const osteoflow_kind *kind, const osteoflow_firing *firing, osteoflow_text params, void **node) {
    (void)kind;
    (void)params;
    /* It has no state, but a node is no null pointer. */
    *node = malloc(1);
    return *node == NULL ? osteoflow_fail(firing, "there is no memory") : OSTEOFLOW_OK;
}

static const osteoflow_kind kinds[] = {
    { .kind = OSTEOFLOW_TEXT("c.lens"), .doc = OSTEOFLOW_TEXT("The lens of an image."), .inputs = in, .n_inputs = 1,
      .outputs = out, .n_outputs = 2, .create = create, .fire = lens, .destroy = free },
};

OSTEOFLOW_PLUGIN("image", "1", kinds)
