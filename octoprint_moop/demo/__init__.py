"""The whole thing without a printer and without a camera: a real server, its virtual printer, a simulated webcam."""
