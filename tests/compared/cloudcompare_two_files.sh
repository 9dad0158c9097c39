#!/usr/bin/env bash
# Registers a scan onto a bone from a start, which a person has made in CloudCompare's window by clicking pairs (a 4 x 4 matrix in a file).
#
#   cloudcompare_two_files.sh BONE SCAN START      writes SCAN's name with _REGISTRATION_MATRIX.txt, to be multiplied with START
set -euo pipefail
xvfb-run -a CloudCompare -SILENT -NO_TIMESTAMP -AUTO_SAVE OFF \
    -O "$2" -APPLY_TRANS "$3" -O "$1" -ICP -ITER 200 -RANDOM_SAMPLING_LIMIT 50000
