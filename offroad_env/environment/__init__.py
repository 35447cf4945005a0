"""The Gymnasium environment: tasks, rewards, observations, one episode or many."""
