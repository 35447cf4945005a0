"""Open-loop replay of logs: what a model predicts from the logged inputs, with nothing fitted."""
