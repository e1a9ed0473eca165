"""Where the machine is: one fixed-lag graph over GNSS, IMU, wheels and lidar odometry, with dead reckoning between."""
