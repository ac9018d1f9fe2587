"""How far a plan is from obstacles and the robot from itself: compiled nearest points, and the parameters of clearance rows."""
