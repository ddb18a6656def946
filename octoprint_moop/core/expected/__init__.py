"""What the camera must see: beads and meshes, through the lens, at any moment of a print."""
