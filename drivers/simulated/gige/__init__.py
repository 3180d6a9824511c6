"""The simulated pair behind GigE Vision: two network cameras that any GenICam client can open."""
