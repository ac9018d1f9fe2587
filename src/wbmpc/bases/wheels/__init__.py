"""Any mix of tires and roller wheels, fixed or steered, with or without an offset: tricycles, cars, powered casters."""
