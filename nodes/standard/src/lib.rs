//! The built-in nodes: thin adapters from ports to algorithms, one file per kind.
