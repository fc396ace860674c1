//! Connections that idle or drip on one listener leave the other listener its places.
