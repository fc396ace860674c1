//! A C3D whose figures disagree about its frames is read by its bytes, or refused.
