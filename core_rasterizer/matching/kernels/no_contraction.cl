/* Products and sums are rounded separately in all that follows, so that all devices agree. */
#pragma OPENCL FP_CONTRACT OFF
