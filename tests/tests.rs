//! One integration binary: a module a topic.

mod architecture;
mod pipeline;
mod replay;
mod support;
mod take_file;
