"""Where the camera stands and what its lens does, from boards, markers, clicks and good prints."""
