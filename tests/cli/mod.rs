//! The command line, run as a program: exit codes, one line on stderr for each error, and an unchanged
//! folder if nothing was to be written.

mod archives;
mod arguments;
mod bad_devices;
mod bad_files;
mod configs;
mod damaged_takes;
mod datasets;
mod demo;
pub(crate) mod devices;
mod documents;
mod edits;
mod exports;
mod faults;
mod folder;
mod forces;
mod full_disk;
mod gaps;
mod imports;
mod lsl;
mod manual;
mod many_files;
mod natnet;
mod ndi;
mod outputs;
mod plots;
mod preparing;
mod qtm;
mod raw_logs;
mod recording;
mod recoveries;
mod reloads;
mod replays;
mod residuals;
pub(crate) mod service;
mod shared_pages;
mod splits;
mod studies;
pub(crate) mod subjects;
mod troubled;
mod unprivileged;
mod verify;
mod views;

pub(crate) use folder::{Folder, Ran};
