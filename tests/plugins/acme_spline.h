/* A payload unknown to the program, shared by the plugin that gives it and the one that takes it. */
#ifndef ACME_SPLINE_H
#define ACME_SPLINE_H

#include "osteoflow_geometry.h"

#define ACME_SPLINE "acme/Spline"
#define ACME_SPLINE_VERSION 1
/* control: double[3], mm */
typedef struct acme_spline {
    osteoflow_text frame;
    int64_t degree;
    /* May be missing. */
    osteoflow_numbers knots;
} acme_spline;

static const osteoflow_part acme_spline_parts[] = {
    { OSTEOFLOW_TEXT("frame"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_PART_TEXT, 0, 0, 0 },
    { OSTEOFLOW_TEXT("degree"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_NO_TEXT, OSTEOFLOW_PART_INT, 0, 0, 0 },
    { OSTEOFLOW_TEXT("knots"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_TEXT("evenly spaced where missing"),
      OSTEOFLOW_PART_FLOAT_LIST, 0, 0, OSTEOFLOW_PART_OPTIONAL },
    { OSTEOFLOW_TEXT("control"), OSTEOFLOW_TEXT("mm"), OSTEOFLOW_NO_TEXT, OSTEOFLOW_PART_COLUMN, 3, OSTEOFLOW_F64, 0 },
};

static const osteoflow_payload acme_payloads[] = {
    { OSTEOFLOW_TEXT(ACME_SPLINE), acme_spline_parts, 4, ACME_SPLINE_VERSION, 0 },
};

#endif
