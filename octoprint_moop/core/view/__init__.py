"""What the camera sees, made comparable: usable, steady, and in one light."""
