//! Files and foreign streams to geometry and back: STL, PLY, Foxglove messages in MCAP, plans, folders.
