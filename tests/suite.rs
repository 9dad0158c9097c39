//! The tests of the command and of the shipped files, as one program: what they share is compiled and linked once.
//!
//! A file beside this one is a module here; `arrows` holds that none is left out.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod advice;
mod archives;
mod arrows;
mod bound_plans;
mod broken_graphs;
mod cited;
#[cfg(unix)]
mod clients;
mod clusters;
mod command_line;
mod common;
#[cfg(unix)]
mod compared;
mod contracts;
mod dependencies;
#[cfg(target_os = "linux")]
mod disk;
mod drawing;
mod experiments;
mod export;
mod failures;
mod formats;
mod foxglove_ws;
mod fuzz;
mod glossary;
mod graphs;
#[cfg(unix)]
mod guides;
mod images;
mod info;
#[cfg(unix)]
mod irregular_files;
mod kept;
mod live;
mod live_joins;
mod live_overload;
mod marker_verdicts;
mod mistakes;
mod modules;
mod new_plugin;
mod new_plugin_like;
mod node_docs;
mod openigtlink;
mod openigtlink_python;
mod own_bone;
mod own_device;
mod paper;
mod paper_page;
#[cfg(unix)]
mod playback;
#[cfg(unix)]
mod plugin_loads;
#[cfg(unix)]
mod plugins;
mod plugins_c;
mod printed;
mod privacy;
#[cfg(unix)]
mod processes;
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
mod processors;
mod public_items;
#[cfg(unix)]
mod python_live;
#[cfg(unix)]
mod python_nodes;
mod python_package;
#[cfg(unix)]
mod reader_tasks;
mod readme;
mod real_sets;
mod recorded;
mod recorded_no_points;
mod refusals;
mod register;
mod register_messages;
mod register_verdict;
mod replay;
mod report;
#[cfg(unix)]
mod report_pictures;
mod ros2;
mod ros2_images;
mod run_folder;
mod schema;
mod sensor;
mod simulate;
mod simulated;
#[cfg(unix)]
mod site;
#[cfg(unix)]
mod size;
mod slicer_module;
mod slicer_plans;
mod slicer_scenes;
mod store;
mod studies;
mod surroundings;
#[cfg(unix)]
mod sweep_times;
mod sweeps;
mod tracking;
mod untrusted;
#[cfg(unix)]
mod verdicts;
#[cfg(unix)]
mod viewer;
#[cfg(unix)]
mod viewer_bones;
#[cfg(unix)]
mod viewer_doors;
#[cfg(unix)]
mod viewer_hands;
#[cfg(unix)]
mod viewer_layout;
#[cfg(unix)]
mod viewer_next;
mod viewer_notebook;
#[cfg(unix)]
mod viewer_picking;
#[cfg(unix)]
mod viewer_soak;
#[cfg(unix)]
mod viewer_steering;
mod viewers;
mod watch;
#[cfg(unix)]
mod words;
mod writing_a_node;
