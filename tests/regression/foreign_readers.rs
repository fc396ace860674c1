//! Other C3D readers open what mocapd exports.
