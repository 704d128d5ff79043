"""Universal Robots arms over the Real-Time Data Exchange (RTDE): a driver for mbcacq and a fake controller."""
