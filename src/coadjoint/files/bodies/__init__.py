"""Mass properties from files: URDF, SDF, MJCF and meshes."""
