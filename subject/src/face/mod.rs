//! From a photograph to a wireframe of the face (Yang et al. 2004, and past it).
