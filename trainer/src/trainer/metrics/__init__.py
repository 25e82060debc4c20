"""What images and detections are judged by; every function states its equation and source."""
