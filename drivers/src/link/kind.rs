//! The type byte of every message.

pub(super) const HELLO: u8 = 0x01;
pub(super) const MARKERS: u8 = 0x02;
pub(super) const FRAME_FLOAT: u8 = 0x10;
pub(super) const FRAME_MICROMETRES: u8 = 0x11;
pub(super) const FRAME_COMPACT: u8 = 0x12;
pub(super) const TRIGGER: u8 = 0x20;
pub(super) const STATUS: u8 = 0x21;
pub(super) const END_OF_STREAM: u8 = 0x22;
pub(super) const PONG: u8 = 0x30;
pub(super) const STARTED: u8 = 0x31;
pub(super) const REFUSED: u8 = 0x32;
pub(super) const RATE_SET: u8 = 0x33;

pub(super) const IDENTIFY: u8 = 0x80;
pub(super) const START: u8 = 0x81;
pub(super) const STOP: u8 = 0x82;
pub(super) const SET_RATE: u8 = 0x83;
pub(super) const PING: u8 = 0x84;
