//! The one table of what may travel on a wire: name, version, view, Foxglove view.
