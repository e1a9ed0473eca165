"""Camera: detector, ground-plane ranging, state of the lens, and the nodes that run them on each picture."""

import cv2

cv2.setNumThreads(1)  # a pool of threads would take the cores of others, and wake up for every picture
