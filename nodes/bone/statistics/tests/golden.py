"""Prints what scipy, statsmodels and numpy answer to the cases of golden.rs, as JSON.

    python golden.py > golden.json        (numpy, scipy, statsmodels, pandas)
"""

import json
import sys

import numpy as np
import pandas as pd
import scipy
import statsmodels
from scipy import stats
from statsmodels.formula.api import ols
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.anova import anova_lm
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint
from statsmodels.stats.weightstats import ttost_paired

rng = np.random.default_rng(20260728)
LEVEL = 0.95


def rounded(n, digits=3, shift=0.0, scale=1.0):
    return [round(float(v), digits) for v in rng.normal(shift, scale, n)]


def grouped(sizes, between=1.0, within=0.5, shift=0.0):
    group, values = [], []
    for unit, size in enumerate(sizes):
        middle = rng.normal(shift, between)
        group += [f"unit {unit:02}"] * size
        values += [round(float(v), 3) for v in rng.normal(middle, within, size)]
    return group, values


def summary(x):
    x = np.array(x)
    return dict(values=x.tolist(), n=len(x), mean=x.mean(), sd=x.std(ddof=1) if len(x) > 1 else None,
                rms=np.sqrt((x**2).mean()), median=np.median(x), p95=np.quantile(x, 0.95), min=x.min(), max=x.max(),
                mean_abs=np.abs(x).mean())


def wilson(k, n, level):
    low, high = proportion_confint(k, n, alpha=1 - level, method="wilson")
    return dict(n_hits=k, n=n, level=level, low=low, high=high)


def wilson_clustered(group, hits):
    """The variance of the mean by statsmodels' cluster-robust least squares on a constant."""
    hits = np.array(hits, dtype=float)
    codes = pd.factorize(np.array(group))[0]
    fit = OLS(hits, np.ones(len(hits))).fit(cov_type="cluster", cov_kwds=dict(groups=codes))
    p = hits.mean()
    few_units = (stats.norm.ppf(0.5 + LEVEL / 2) / stats.t.ppf(0.5 + LEVEL / 2, codes.max())) ** 2
    n_effective = min(p * (1 - p) / fit.cov_params()[0, 0] * few_units, len(hits))
    low, high = proportion_confint(p * n_effective, n_effective, alpha=1 - LEVEL, method="wilson")
    return dict(group=group, hits=hits.astype(bool).tolist(), level=LEVEL, n_effective=n_effective, low=low, high=high)


def wilcoxon(d):
    d = np.array(d, dtype=float)
    nonzero = d[d != 0]
    ranks = stats.rankdata(np.abs(nonzero))
    plus, minus = ranks[nonzero > 0].sum(), ranks[nonzero < 0].sum()
    pairs = [(d[i] + d[j]) / 2 for i in range(len(d)) for j in range(i, len(d))]
    p = stats.wilcoxon(d, zero_method="wilcox", correction=False, method="auto").pvalue
    return dict(differences=d.tolist(), n_zeros=int((d == 0).sum()), w_plus=plus, w_minus=minus, p=p,
                rank_biserial=(plus - minus) / (plus + minus), hodges_lehmann=np.median(pairs))


def tost(d, margin, alpha):
    p, (_, p_lower, _), (_, p_upper, _) = ttost_paired(np.array(d), np.zeros(len(d)), -margin, margin)
    low, high = stats.t.interval(1 - 2 * alpha, len(d) - 1, np.mean(d), stats.sem(d))
    return dict(differences=d, margin=margin, alpha=alpha, p=p, p_lower=p_lower, p_upper=p_upper, low=low, high=high)


def bland_altman(d):
    n, bias, sd = len(d), np.mean(d), np.std(d, ddof=1)
    t = stats.t.ppf(0.5 + LEVEL / 2, n - 1)
    half = t * sd * np.sqrt(1 / n + 1.96**2 / (2 * (n - 1)))
    lower, upper = bias - 1.96 * sd, bias + 1.96 * sd
    return dict(differences=d, level=LEVEL, bias=bias, sd=sd, lower=lower, upper=upper,
                bias_interval=list(stats.t.interval(LEVEL, n - 1, bias, stats.sem(d))),
                lower_interval=[lower - half, lower + half], upper_interval=[upper - half, upper + half])


def one_way(group, values):
    table = anova_lm(ols("value ~ C(unit)", pd.DataFrame(dict(unit=group, value=values))).fit())
    sizes = np.unique(group, return_counts=True)[1]
    n, g = sizes.sum(), len(sizes)
    return table.mean_sq.iloc[0], table.mean_sq.iloc[1], (n - (sizes**2).sum() / n) / (g - 1), n, g


def repeatability(group, values):
    msb, msw, n0, _, _ = one_way(group, values)
    return dict(group=group, values=values, n0=n0, sd_within=np.sqrt(msw), sd_between=np.sqrt(max(0, (msb - msw) / n0)),
                coefficient=1.96 * np.sqrt(2 * msw), icc=(msb - msw) / (msb + (n0 - 1) * msw))


def pearson(x, y):
    found = stats.pearsonr(x, y)
    interval = found.confidence_interval(LEVEL)
    return dict(x=x, y=y, level=LEVEL, r=found.statistic, p=found.pvalue, low=interval.low, high=interval.high)


def spearman(x, y):
    found = stats.spearmanr(x, y)
    r = found.statistic
    half = stats.norm.ppf(0.5 + LEVEL / 2) * np.sqrt((1 + r * r / 2) / (len(x) - 3))
    low, high = np.tanh(np.arctanh(r) - half), np.tanh(np.arctanh(r) + half)
    return dict(x=x, y=y, level=LEVEL, r=r, p=found.pvalue, low=low, high=high)


def bootstrap(values, statistic, kind):
    """Another stream of draws than ours: the ends agree as far as 200,000 resamples hold them still."""
    found = stats.bootstrap((np.array(values),), getattr(np, statistic), n_resamples=200_000, confidence_level=LEVEL,
                            method=kind, rng=np.random.default_rng(1), batch=10_000)
    interval = found.confidence_interval
    return dict(values=values, statistic=statistic, kind=kind, level=LEVEL, low=interval.low, high=interval.high)


x = rounded(30)
noisy = [round(v + float(e), 3) for v, e in zip(x, rng.normal(0, 0.4, 30))]
stepped = [round(v * 2) / 2 for v in noisy]
skewed = [round(float(v), 3) for v in rng.exponential(1.0, 25)]
hits_group, hits_values = grouped([3, 7, 10, 4, 8, 12, 6, 5])

golden = dict(
    versions=dict(numpy=np.__version__, scipy=scipy.__version__, statsmodels=statsmodels.__version__),
    summary=[summary(v) for v in [[2.5], [1.0, 1.0, 1.0], [-0.4, 0.9], rounded(7), rounded(1000, shift=0.2)]],
    wilson=[wilson(k, n, level) for level in [0.9, 0.95, 0.99]
            for k, n in [(0, 1), (1, 1), (0, 10), (3, 10), (10, 10), (197, 200)]],
    wilson_clustered=[wilson_clustered(hits_group, [abs(v) < limit for v in hits_values]) for limit in [0.5, 1.0, 1.5]]
    + [wilson_clustered(["a", "a", "b", "b"], [True, False, False, False])],
    wilcoxon=[wilcoxon(d) for d in [
        [0.4], [0.1, -0.2], rounded(6), rounded(12, shift=0.5), rounded(50, shift=0.2), rounded(51, shift=0.2),
        [1, 1, -1, 2, 2, -3, 3],                               # ties, few
        [0, 0, 1, -2, 3, 4, 5],                                # zeros, few
        [round(v) for v in rounded(13, scale=3)],              # both, the last to be exact
        [round(v) for v in rounded(14, scale=3)],              # both, the first that is not
        [round(v) for v in rounded(80, shift=0.5, scale=3)],
        [2, 2, 2, 2], rounded(300, shift=0.05)]],
    holm=[dict(p=p, corrected=multipletests(p, method="holm")[1].tolist()) for p in [
        [0.03], [0.01, 0.04, 0.03], [0.5, 0.5, 0.6], [0.001, 0.001, 0.2, 0.04, 1.0, 0.0],
        [round(float(v), 4) for v in rng.uniform(0, 0.1, 12)]]],
    tost=[tost(rounded(n, shift=shift, scale=scale), margin, alpha) for n, shift, scale, margin, alpha in [
        (2, 0.0, 0.1, 0.5, 0.05), (10, 0.05, 0.2, 0.3, 0.05), (40, 0.2, 0.5, 0.3, 0.05), (40, 1.0, 0.5, 0.3, 0.01)]],
    bland_altman=[bland_altman(rounded(n, shift=0.3)) for n in [2, 5, 17, 100]],
    repeatability=[repeatability(*grouped(sizes, between)) for sizes, between in [
        ([5] * 8, 1.0), ([2, 7, 3, 9, 1, 4], 1.0), ([10] * 10, 0.0), ([2, 1], 1.0)]],
    pearson=[pearson(x, noisy), pearson(x[:4], noisy[:4]), pearson(x, rounded(30)), pearson(x, [-v for v in noisy])],
    spearman=[spearman(x, noisy), spearman(x[:5], noisy[:5]), spearman(x, stepped), spearman(x, rounded(30))],
    bootstrap=[bootstrap(v, statistic, kind) for v in [noisy, skewed] for statistic in ["mean", "median"]
               for kind in ["percentile", "BCa"]],
)
json.dump(golden, sys.stdout, indent=None, separators=(",", ":"), default=lambda v: v.item())
print()
