//! The service over HTTP: a small API, what happens as it happens, and the dashboard.
//!
//! ```text
//! Unix socket ─┐                                                   ┌─► Control::status: at once
//!              ├─► connection: bounds, ─► guard: Host, ─► route ───┼─► lane ─► Control::start …: a thread that may wait
//! TCP ─────────┘   time limits            Origin, token            └─► hub ◄── Control::events, live: a thread each
//! ```
//!
//! Each listener has a thread of its own, `mocapd-socket` and `mocapd-tcp`, and a bounded number of threads for what
//! waits, so that clients of one never wait for those of the other; the data plane knows nothing of it. docs/api.md has the routes and what is promised of them.

mod assets;
mod auth;
mod body;
mod check;
mod commands;
mod connection;
mod counts;
mod devices;
mod document;
mod download;
mod events;
mod guard;
mod happenings;
mod lanes;
mod listen;
mod live;
mod login;
mod metrics;
mod options;
mod pages;
mod places;
mod problem;
mod range;
mod reading;
mod routes;
mod server;
mod show;
mod stall;
mod state;
mod takes;

pub use self::{
    check::TakeCheck,
    options::{CONNECTIONS_MAX, HttpOptions, TimeLimits},
    problem::{Problem, ProblemKind},
    routes::openapi,
    server::HttpServer,
};
