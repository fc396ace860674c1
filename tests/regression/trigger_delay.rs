//! A delayed trigger holds up no other.
