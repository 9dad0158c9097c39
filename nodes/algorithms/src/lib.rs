//! Surface registration as plain functions: Kabsch, ICP, hole detection, regions, metrics.
