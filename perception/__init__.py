"""From raw returns and pictures to obstacles, tracks and the health of each sensor."""
