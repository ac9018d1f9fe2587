"""Model predictive control: receding horizon, policy, queue of policies, input filters."""
