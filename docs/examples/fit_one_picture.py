"""Fit Gaussians to a picture with only the rasterizer: python fit_one_picture.py [PICTURE] [ITERATIONS]"""

import sys

import numpy as np
import torch
from PIL import Image
from skimage import data

from core_rasterizer import Camera, photometric_loss, rasterize

picture = Image.open(sys.argv[1]).convert("RGB") if sys.argv[1:] else Image.fromarray(data.coffee())
picture.thumbnail((300, 300))
target = torch.from_numpy(np.asarray(picture, dtype=np.float32) / 255)
height, width, _ = target.shape

# The camera is at the origin and looks along +z; a pixel at depth 1 is 1 / focal world units wide.
focal, count = float(width), 3000
camera = Camera(torch.eye(4), focal, focal, width / 2, height / 2, width, height)
torch.set_num_threads(1)  # more threads would compete with those of the OpenCL device
torch.manual_seed(0)
positions = (torch.rand(count, 2) - 0.5) * torch.tensor([width, height]) / focal
means = torch.cat([positions, torch.ones(count, 1)], dim=1).requires_grad_()
log_scales = torch.full((count, 3), np.log(4 / focal)).requires_grad_()
quaternions = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1).requires_grad_()
logits = torch.zeros(count).requires_grad_()
sh = torch.zeros(count, 1, 3).requires_grad_()
rates = {means: 2e-3, log_scales: 2e-2, quaternions: 2e-2, logits: 5e-2, sh: 2e-2}
optimizer = torch.optim.Adam([{"params": [p], "lr": rate} for p, rate in rates.items()])

for iteration in range(1, 1 + (int(sys.argv[2]) if sys.argv[2:] else 300)):
    optimizer.zero_grad()
    image = rasterize(means, quaternions, log_scales.exp(), logits.sigmoid(), sh, camera).rgb
    photometric_loss(image, target).backward()
    optimizer.step()
    if iteration % 100 == 0:
        psnr = -10 * torch.log10((image.detach().clamp(0, 1) - target).square().mean())
        print(f"iteration {iteration}: PSNR {psnr:.2f} dB")
side_by_side = torch.cat([target, image.detach().clamp(0, 1)], dim=1)
Image.fromarray((side_by_side * 255).round().byte().numpy()).save("fitted.png")
