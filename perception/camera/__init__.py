"""Camera: detector, ground-plane ranging, image quality, and the nodes that run them on each image."""

import cv2

cv2.setNumThreads(1)  # a thread pool would take the cores of other processes
