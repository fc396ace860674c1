//! Every defect that was found in use, a module a symptom: each test failed before its fix.

mod analog_stride;
mod control_characters;
mod crafted_takes;
mod ctl_answers;
mod cut_limbs;
mod device_away;
mod event_numbers;
mod foreign_readers;
mod idle_connections;
mod local_time;
mod negative_residuals;
mod noise;
mod nothing_to_compare;
mod repeated_labels;
mod rounded_meshes;
mod sparse_files;
mod special_files;
mod stalled_stop;
mod take_health;
mod text_dialects;
mod torn_header;
mod trigger_delay;
mod unknown_units;
mod up_axis;
mod vanished_take;
mod wrong_token;
