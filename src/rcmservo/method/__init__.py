"""The paper's method: kinematics, projection, features, imaged RCM, estimators, law, first
motion."""
