"""What repeating one stationary measurement for ever leaves: the paper's Theorem 2, as printed and corrected."""

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float

from ...core.gaussian import solve_psd, symmetrise

Square = Float[np.ndarray, "n n"]


def after(information: Square, H: Float[np.ndarray, "m n"], R: Float[np.ndarray, "m m"], k: float) -> Square:
    """`P_k = (Lambda_0 + k H^T R^-1 H)^-1` after k uses. # [Kojima12] eq. 19, 28"""
    W = H.T @ solve_psd(R, H)  # [Kojima12] eq. 17
    return symmetrise(np.linalg.inv(symmetrise(information + k * W)))


def limit(information: Square, H: Float[np.ndarray, "m n"]) -> Square:
    """`P_inf = Z (Z^T Lambda_0 Z)^-1 Z^T`, Z a basis of the null space of H: what no repetition takes away.

    The corrected form of the paper's eq. 23; `P_k` approaches it as 1/k.
    """
    Z = sla.null_space(H)
    return symmetrise(Z @ solve_psd(symmetrise(Z.T @ information @ Z), Z.T))  # [Kojima12] eq. 23


def printed_limit(
    frames: Float[np.ndarray, "r r"],
    landmarks: Float[np.ndarray, "l l"],
    H_r: Float[np.ndarray, "m r"],
    H_l: Float[np.ndarray, "m l"],
) -> Float[np.ndarray, "n n"]:
    """The paper's closed form of the limit; exact only when the map holds every global landmark (N = n).

    frames, landmarks: the diagonal blocks of the initial information matrix (its eq. 22); H_r, H_l: the columns of
    H that belong to the frame and to the landmarks.
    """
    G = np.linalg.pinv(H_l) @ H_r
    phi11 = np.linalg.inv(frames + G.T @ landmarks @ G)  # [Kojima12] eq. 24
    phi12 = -phi11 @ G.T  # [Kojima12] eq. 25
    phi21 = -G @ phi11  # [Kojima12] eq. 26
    phi22 = G @ phi11 @ G.T  # [Kojima12] eq. 27
    return np.block([[phi11, phi12], [phi21, phi22]])
