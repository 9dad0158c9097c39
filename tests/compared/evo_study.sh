#!/usr/bin/env bash
# Compares the poses of two methods with the true ones: files of lines "seconds x y z qx qy qz qw", which the user writes.
#
#   evo_study.sh TRUTH ONE TWO      prints maximum, mean, median, RMSE and SD of each
set -euo pipefail
evo_ape tum "$1" "$2" --save_results one.zip --no_warnings
evo_ape tum "$1" "$3" --save_results two.zip --no_warnings
evo_res one.zip two.zip --save_table table.csv --no_warnings
cat table.csv
