"""Detections, images and maps from frames of any origin."""
