"""Universal Robots arms over the Real-Time Data Exchange (RTDE)."""
