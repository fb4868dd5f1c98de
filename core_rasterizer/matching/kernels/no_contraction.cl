/* A product and a sum stay two operations, each rounded, in all that follows: every device gets the same. */
#pragma OPENCL FP_CONTRACT OFF
